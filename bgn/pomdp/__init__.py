"""What a POMDP is: tabular models, the Cassandra file format, and exact belief updates."""

from bgn.pomdp._errors import PomdpFormatError
from bgn.pomdp.belief import ImpossibleObservationError, update, update_hidden
from bgn.pomdp.model import MOMDP, POMDP, ModelError
from bgn.pomdp.reader import load, loads
from bgn.pomdp.writer import dumps, save

__all__ = [
    "MOMDP",
    "POMDP",
    "ImpossibleObservationError",
    "ModelError",
    "PomdpFormatError",
    "dumps",
    "load",
    "loads",
    "save",
    "update",
    "update_hidden",
]
