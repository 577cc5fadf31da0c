"""The first steps of docs/python.md are a program that runs."""

import contextlib
import io
import pathlib
import re
import textwrap
import unittest

PAGE = pathlib.Path(__file__).resolve().parents[3] / "docs/python.md"
MOST_LINES = 5


def blocks():
    """Titles and code of the section."""
    section = PAGE.read_text().split("## First steps\n", 1)[1].split("\n## ", 1)[0]
    found = re.findall(r"^(\w[^\n|]*):\n\n((?:    [^\n]*\n)+)", section, re.MULTILINE)
    return [(title, textwrap.dedent(code)) for title, code in found]


class FirstSteps(unittest.TestCase):
    """What a newcomer does first."""

    def test_each_is_short_and_all_run(self):
        """One after the other, as on the page."""
        names = {}
        steps = blocks()
        self.assertEqual(len(steps), 10)
        for title, code in steps:
            with self.subTest(title), contextlib.redirect_stdout(io.StringIO()):
                self.assertLessEqual(len(code.splitlines()), MOST_LINES)
                exec(code, names)
        self.assertTrue(names["goal"].reached)
        self.assertEqual(names["picture"].shape, (48, 64, 3))
        self.assertEqual(names["jacobian"].shape, (6, 7))


if __name__ == "__main__":
    unittest.main()
