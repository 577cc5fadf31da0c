"""Profile accurate has the right value in all cases of docs/conformance.md."""

import sys
import unittest
from pathlib import Path

CASES = Path(__file__).resolve().parents[2] / "benchmarks/conformance"
sys.path.insert(0, str(CASES))
import ambf_adapter  # noqa: E402
import cases  # noqa: E402


class Conformance(unittest.TestCase):
    """Each case at each of its steps."""

    def test_all_are_right(self):
        """Rows are what was found, what is right, and how far off it may be."""
        for case in cases.CASES:
            for step in case.steps:
                with self.subTest(case.name, step=step):
                    wrong = [row for row in case.run(ambf_adapter.Accurate, step) if not row.passes]
                    self.assertEqual(wrong, [])


if __name__ == "__main__":
    unittest.main()
