"""What README and CLAIMS.md say of the results is what the store says."""

from __future__ import annotations

import pytest

from benchmarks import documents, pooled
from bgn.errors import BgnError


def test_documents_say_what_the_results_say() -> None:
    found = pooled.load(documents.ROOT / "results" / "published")
    for path, text in documents.documents(found).items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name}: python -m benchmarks.documents"


def test_a_block_is_replaced_between_its_markers() -> None:
    text = f"before\n{documents.BEGIN}\nold\n{documents.END}\nafter\n"
    assert documents.with_block(text, "new\n") == f"before\n{documents.BEGIN}\nnew\n{documents.END}\nafter\n"
    with pytest.raises(BgnError, match="no block"):
        documents.with_block("nothing", "new\n")
