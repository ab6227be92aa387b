"""Skips tests of pictures where a machine cannot draw, and only there."""

from __future__ import annotations

import functools

import pytest

from bgn.physics import RenderingUnavailableError
from bgn.physics.top_plate import TopPlateScene
from bgn.pictures.camera import Camera


@functools.cache
def why_not() -> str | None:
    """The reason this machine cannot draw off-screen, if it cannot."""
    scene = TopPlateScene()
    scene.reset(3, 0)
    try:
        camera = Camera(scene, 16, 16)
    except RenderingUnavailableError as error:
        return str(error)
    camera.close()
    return None


def needs_graphics() -> None:
    """Skip the calling test where this machine cannot draw."""
    if reason := why_not():
        pytest.skip(reason)
