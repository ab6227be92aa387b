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
from bgn.planning.alpha_vectors import AlphaVectors
from bgn.pomdp.model import Floats

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
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise PolicyFormatError(f"{path}: not XML: {error}") from None
    pool = root.find("AlphaVector")
    if root.tag != "Policy" or pool is None:
        raise PolicyFormatError(f"{path}: expected <Policy> with an <AlphaVector> inside, found <{root.tag}>")
    length, n_observed = (_count(path, pool, name) for name in ("vectorLength", "numObsValue"))
    elements = [element for element in pool if element.tag in ("Vector", "SparseVector")]
    declared = _count(path, pool, "numVectors")
    if len(elements) != declared or not elements:
        raise PolicyFormatError(f"{path}: numVectors is {declared}, but there are {len(elements)} vectors")
    parts = np.stack([_entries(path, row, element, length) for row, element in enumerate(elements)])
    vectors = np.full((len(elements), n_observed, length), parts.min() - 1.0)
    x = [_index(path, row, element, "obsValue", n_observed) for row, element in enumerate(elements)]
    vectors[np.arange(len(elements)), x] = parts
    actions = [_index(path, row, element, "action", None) for row, element in enumerate(elements)]
    return AlphaVectors(vectors=vectors.reshape(len(elements), -1), actions=np.array(actions, dtype=np.int64))


def _count(path: str | os.PathLike[str], pool: ElementTree.Element, name: str) -> int:
    text = pool.get(name, "")
    if not text.strip().isdecimal() or int(text) < 1:
        raise PolicyFormatError(f"{path}: <AlphaVector> needs {name} as a positive number, found {text!r}")
    return int(text)


def _index(
    path: str | os.PathLike[str], row: int, element: ElementTree.Element, name: str, limit: int | None
) -> int:
    text = element.get(name, "")
    if not text.strip().isdecimal() or (limit is not None and int(text) >= limit):
        expected = "a number" if limit is None else f"a number below {limit}"
        raise PolicyFormatError(f"{path}: vector {row} needs {name} as {expected}, found {text!r}")
    return int(text)


def _entries(path: str | os.PathLike[str], row: int, element: ElementTree.Element, length: int) -> Floats:
    """Return the numbers of one vector, shape (length,)."""
    try:
        if element.tag == "Vector":
            values = np.array((element.text or "").split(), dtype=np.float64)
        else:
            values = np.zeros(length)
            for entry in element.iter("Entry"):
                index, number = (entry.text or "").split()
                values[int(index)] = float(number)
    except (ValueError, IndexError) as error:
        raise PolicyFormatError(f"{path}: vector {row}: {error}") from None
    if values.size != length or not np.isfinite(values).all():
        raise PolicyFormatError(f"{path}: vector {row} needs {length} finite numbers, found {values.size}")
    return values
