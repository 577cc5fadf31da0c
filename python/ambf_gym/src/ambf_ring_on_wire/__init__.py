"""Ring on wire: a ring is brought along a wire of several bends; docs/competition.md.

`wire` says where the wire is, `Judge` how a run stands, `player` plays by a script (it needs the package `ambf`).
"""
