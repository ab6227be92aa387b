"""Alpha vectors in the XML format of APPL's tools (``.policy``, "PolicyX" 0.1).

``<AlphaVector vectorLength numObsValue numVectors>`` holds ``<Vector action obsValue>`` elements of numbers,
or
``<SparseVector>`` ones of ``<Entry>index number</Entry>``. For a mixed-observability model ``obsValue`` is x
and the numbers are over y; ours are always written over all states, with a single ``obsValue``.
"""

from __future__ import annotations

import os
from xml.etree import ElementTree

import numpy as np

from bgn.errors import BgnError
from bgn.policies.alpha_vectors import AlphaVectors
from bgn.pomdp.model import Floats

#: Most numbers of all vectors together, beside those that the file itself has room for.
MAX_NUMBERS = 20_000_000
#: Above every size and index that fits in memory.
_MAX_INTEGER = 2**31 - 1

_XSI = "http://www.w3.org/2001/XMLSchema-instance"


class PolicyFormatError(BgnError, ValueError):
    """A file that is not a policy of alpha vectors; the message says where and what was expected."""


def save(policy: AlphaVectors, path: str | os.PathLike[str], *, model: str = "") -> None:
    """Write a policy; ``model`` is the name of the file it is for, for the record."""
    ElementTree.register_namespace("xsi", _XSI)
    attributes = {"version": "0.1", "type": "value", "model": model}
    root = ElementTree.Element(
        "Policy", {**attributes, f"{{{_XSI}}}noNamespaceSchemaLocation": "policyx.xsd"}
    )
    n, length = policy.vectors.shape
    sizes = {"vectorLength": str(length), "numObsValue": "1", "numVectors": str(n)}
    pool = ElementTree.SubElement(root, "AlphaVector", sizes)
    for vector, action in zip(policy.vectors, policy.actions, strict=True):
        element = ElementTree.SubElement(pool, "Vector", {"action": str(action), "obsValue": "0"})
        element.text = " ".join(map(repr, vector.tolist())) + " "
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="ISO-8859-1", xml_declaration=True)


def model_name(path: str | os.PathLike[str]) -> str:
    """Return the name of the model that a policy says it is for.

    Raises
    ------
    PolicyFormatError
        The file is not a policy of alpha vectors.
    OSError
        It cannot be read.
    """
    return _root(path).get("model", "")


def load(path: str | os.PathLike[str]) -> AlphaVectors:
    """Read a policy.

    A vector for one ``obsValue`` gets, at the states of the others, a value below all entries of the file, so
    that it is never the best there.

    Raises
    ------
    PolicyFormatError
        The file is not such a policy.
    OSError
        It cannot be read.
    """
    pool = _root(path).find("AlphaVector")
    assert pool is not None
    length, n_observed = (_count(path, pool, name) for name in ("vectorLength", "numObsValue"))
    elements = [element for element in pool if element.tag in ("Vector", "SparseVector")]
    declared = _count(path, pool, "numVectors")
    if len(elements) != declared or not elements:
        raise PolicyFormatError(f"{path}: numVectors is {declared}, but there are {len(elements)} vectors")
    size, most = len(elements) * n_observed * length, MAX_NUMBERS + 3 * os.stat(path).st_size
    if size > most:
        raise PolicyFormatError(f"{path}: vectors of {size} numbers in all; expected at most {most}")
    parts = np.stack([_entries(path, row, element, length) for row, element in enumerate(elements)])
    vectors = np.full((len(elements), n_observed, length), parts.min() - 1.0)
    x = [_index(path, row, element, "obsValue", n_observed) for row, element in enumerate(elements)]
    vectors[np.arange(len(elements)), x] = parts
    actions = [_index(path, row, element, "action", None) for row, element in enumerate(elements)]
    return AlphaVectors(vectors=vectors.reshape(len(elements), -1), actions=np.array(actions, dtype=np.int64))


def _root(path: str | os.PathLike[str]) -> ElementTree.Element:
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # the latter two: of its encoding
        raise PolicyFormatError(f"{path}: not XML: {error}") from None
    if root.tag != "Policy" or root.find("AlphaVector") is None:
        raise PolicyFormatError(f"{path}: expected <Policy> with an <AlphaVector> inside, found <{root.tag}>")
    return root


def _count(path: str | os.PathLike[str], pool: ElementTree.Element, name: str) -> int:
    text = pool.get(name, "")
    value = _integer(text)
    if value is None or value < 1:
        found = f"found {text[:40]!r}"
        raise PolicyFormatError(f"{path}: <AlphaVector> needs {name} as a positive number, {found}")
    return value


def _index(
    path: str | os.PathLike[str], row: int, element: ElementTree.Element, name: str, limit: int | None
) -> int:
    text = element.get(name, "")
    value = _integer(text)
    if value is None or (limit is not None and value >= limit):
        expected = "a number" if limit is None else f"a number below {limit}"
        raise PolicyFormatError(f"{path}: vector {row} needs {name} as {expected}, found {text[:40]!r}")
    return value


def _integer(text: str) -> int | None:
    """Return the number that a text of digits is, None if it is none that could be meant."""
    digits = text.strip()
    if not (digits.isascii() and digits.isdecimal() and len(digits) <= len(str(_MAX_INTEGER))):
        return None
    return int(digits) if int(digits) <= _MAX_INTEGER else None


def _entries(path: str | os.PathLike[str], row: int, element: ElementTree.Element, length: int) -> Floats:
    """Return the numbers of one vector, shape (length,)."""
    try:
        if element.tag == "Vector":
            values = np.array((element.text or "").split(), dtype=np.float64)
        else:
            values = np.zeros(length)
            for entry in element.iter("Entry"):
                where, number = (entry.text or "").split()
                index = _integer(where)
                if index is None or index >= length:
                    raise ValueError(f"index {where[:40]} is out of range; expected 0 to {length - 1}")
                values[index] = float(number)
    except ValueError as error:
        raise PolicyFormatError(f"{path}: vector {row}: {error}") from None
    if values.size != length or not np.isfinite(values).all():
        raise PolicyFormatError(f"{path}: vector {row} needs {length} finite numbers, found {values.size}")
    return values
