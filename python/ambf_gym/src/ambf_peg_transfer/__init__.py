"""The peg transfer: where things stand on its board, what a run is drawn from, and who counts the points.

Nothing here needs more than Python: the same referee judges a simulation in this process, an environment of Gymnasium, and one that is
watched over ROS 1 or ROS 2 (`python -m ambf_peg_transfer`). docs/competition.md.
"""

from .board import ASYMMETRIC, SYMMETRIC, Board
from .referee import Pose, Referee, Score
from .seeds import Draw, draw, uniform

__all__ = ["ASYMMETRIC", "SYMMETRIC", "Board", "Draw", "Pose", "Referee", "Score", "draw", "uniform"]
