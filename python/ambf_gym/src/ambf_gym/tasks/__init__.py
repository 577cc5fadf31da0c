"""Worked tasks: templates for one's own."""

from .lift import make_lift
from .reach import make_reach

__all__ = ["make_lift", "make_reach"]
