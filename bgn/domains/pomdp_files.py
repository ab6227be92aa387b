"""The classic domains as .pomdp files with their checksums."""

from __future__ import annotations

import hashlib
from pathlib import Path

from bgn.domains.domain import Domain
from bgn.domains.registry import get, ids

CHECKSUMS = "SHA256SUMS"
"""Name of the checksum file, as ``sha256sum --check`` reads it."""


def write(folder: Path) -> list[Path]:
    """Write every classic domain to ``folder`` as ``<id>.pomdp``, and the checksums; return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {f"{domain.id}.pomdp": _text(domain) for domain in map(get, ids()) if domain.family == "classic"}
    sums = {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()}
    texts[CHECKSUMS] = "".join(f"{digest}  {name}\n" for name, digest in sums.items())
    paths = [folder / name for name in texts]
    for path, text in zip(paths, texts.values(), strict=True):
        path.write_text(text, encoding="utf-8", newline="\n")
    return paths


def _text(domain: Domain) -> str:
    from bgn.pomdp.writer import dumps  # imported here: it needs the parser's words, which training does not

    comment = (
        f"{domain.title}, episodes of at most {domain.episode_limit} steps\n"
        "Written by `bgn write`: change the generator, not this file."
    )
    return dumps(domain.model.joint, comment=comment)
