"""What a POMDP is: tabular models, the Cassandra file format, and exact belief updates."""

from bgn.pomdp._errors import PomdpFormatError
from bgn.pomdp.belief import ImpossibleObservationError, update, update_hidden
from bgn.pomdp.model import MOMDP, POMDP, ModelError
from bgn.pomdp.reader import load, loads

__all__ = [
    "MOMDP",
    "POMDP",
    "ImpossibleObservationError",
    "ModelError",
    "PomdpFormatError",
    "load",
    "loads",
    "update",
    "update_hidden",
]
