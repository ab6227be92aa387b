"""The seven domains of the paper, one module each, behind one lookup: ``domains.get("hallway")``."""

from bgn.domains.domain import Domain, Features
from bgn.domains.registry import UnknownDomainError, get, ids

__all__ = ["Domain", "Features", "UnknownDomainError", "get", "ids"]
