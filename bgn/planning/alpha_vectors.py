from dataclasses import dataclass
import numpy as np
@dataclass(frozen=True, eq=False, kw_only=True)
class AlphaVectors:
    vectors: object
    actions: object
