"""Worked tasks: templates for one's own."""

from .lift import make_lift, make_lift_vec
from .needle_pick import make_needle_pick, make_needle_pick_vec
from .peg_lift import make_peg_lift, make_peg_lift_vec
from .peg_transfer import make_peg_transfer, make_peg_transfer_vec
from .reach import make_reach, make_reach_vec
from .ring_on_wire import make_ring_on_wire, make_ring_on_wire_vec

__all__ = [
    "make_lift",
    "make_lift_vec",
    "make_needle_pick",
    "make_needle_pick_vec",
    "make_peg_lift",
    "make_peg_lift_vec",
    "make_peg_transfer",
    "make_peg_transfer_vec",
    "make_reach",
    "make_reach_vec",
    "make_ring_on_wire",
    "make_ring_on_wire_vec",
]
