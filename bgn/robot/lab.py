"""The laboratory's numbers, read from one TOML file and checked: arm, gripper, task stations, twin."""

from __future__ import annotations

import tomllib
from functools import cached_property
from pathlib import Path
from typing import Annotated, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from bgn.robot import kinematics
from bgn.robot.errors import UsageError
from bgn.robot.kinematics import Floats

DEFAULT: Final = Path(__file__).with_name("lab.toml")
ORTHOGONAL: Final = 1e-3

Positive = Annotated[float, Field(gt=0)]
Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Arm(_Section):
    """What the arm may do; every field is explained in ``lab.toml``."""

    model: str
    oldest_polyscope: tuple[int, int]
    tcp: Vector6
    payload: Annotated[float, Field(ge=0, le=5)]
    payload_centre: Vector3
    speed: Positive
    first_lap_speed: Positive
    speed_cap: Annotated[float, Field(gt=0, le=0.25)]
    acceleration: Positive
    joint_speed: Annotated[float, Field(gt=0, le=1.05)]
    joint_acceleration: Positive
    stop_deceleration: Positive
    force_limit: Positive
    watchdog_frequency: Positive
    stale_after: Positive
    command_timeout: Positive
    rest_speed: Positive
    target_tolerance: Positive
    settle: Annotated[float, Field(ge=0)]
    sample_rate: Annotated[float, Field(ge=125, le=500)]
    condition_limit: Positive

    @model_validator(mode="after")
    def _keep_to_the_cap(self) -> Arm:
        for name in ("speed", "first_lap_speed"):
            if getattr(self, name) > self.speed_cap:
                raise ValueError(
                    f"arm.{name} = {getattr(self, name)} m/s is above the cap of {self.speed_cap} m/s"
                )
        return self


class Gripper(_Section):
    """What the gripper is told and how long it may take."""

    port: Annotated[int, Field(gt=0, lt=65536)]
    reply_port: Annotated[int, Field(gt=0, lt=65536)]
    timeout: Positive
    retries: Annotated[int, Field(ge=0, le=20)]
    soft: Positive
    stiff: Positive
    fixed: Positive
    fixed_position: float
    baseline_samples: Annotated[int, Field(ge=3)]
    baseline_spread: Positive
    baseline_offset: Positive
    reading_samples: Annotated[int, Field(ge=1)]
    maximum_velocity: Positive


class Station(_Section):
    """Where one task stands before the arm, and how its finger is read."""

    origin: Vector3
    axes: tuple[Vector3, ...]
    shape: tuple[Annotated[int, Field(gt=1)], ...]
    pitch: Positive
    orientation: Vector3
    near: Vector6
    window: Positive
    retreat: Vector3
    workspace: tuple[Vector3, Vector3]
    fingers: tuple[Annotated[int, Field(ge=0, le=1)], ...]
    signs: tuple[int, ...]
    angle_edges: tuple[float, ...]

    @model_validator(mode="after")
    def _fit_together(self) -> Station:
        axes = len(self.axes)
        if not len(self.shape) == len(self.fingers) == len(self.signs) == axes:
            raise ValueError(f"there are {axes} axes, so shape, fingers and signs need {axes} entries each")
        products = np.array(self.axes) @ np.array(self.axes).T
        if np.abs(products - np.eye(axes)).max() > ORTHOGONAL:
            raise ValueError("the axes must be orthogonal and of length 1")
        if any(sign not in (-1, 1) for sign in self.signs):
            raise ValueError("a sign is 1 or -1")
        if list(self.angle_edges) != sorted(set(self.angle_edges)):
            raise ValueError("the angle edges must increase")
        return self

    def hinge(self, coordinates: tuple[float, ...]) -> Floats:
        """Return the hinge's position (3,) at grid coordinates, one per axis."""
        position: Floats = np.array(self.origin) + self.pitch * (np.array(coordinates) @ np.array(self.axes))
        return position

    def pose(self, coordinates: tuple[float, ...], *, retreat: bool = False) -> Floats:
        """Return the tool's pose (6,) at grid coordinates, or beside them where nothing is in the way."""
        position = self.hinge(coordinates) + (np.array(self.retreat) if retreat else 0.0)
        return np.concatenate([position, self.orientation])

    def coordinates(self, position: Floats) -> Floats:
        """Return the grid coordinates (axes,), not rounded, of a hinge position (3,)."""
        found: Floats = np.array(self.axes) @ (position - np.array(self.origin)) / self.pitch
        return found

    def contains(self, position: Floats) -> bool:
        """Whether a hinge position (3,) lies in the workspace box."""
        corners = np.sort(np.array(self.workspace), axis=0)
        return bool(((corners[0] <= position) & (position <= corners[1])).all())


class Twin(_Section):
    """How the twin differs from a perfect robot."""

    serial: Annotated[str, Field(pattern=r"^\d{1,20}$")]
    polyscope: Annotated[str, Field(pattern=r"^\d+\.\d+\.\d+\.\d+$")]
    servo_lag: Annotated[float, Field(ge=0, le=0.2)]
    angle_noise: Annotated[float, Field(ge=0)]
    angle_drift: float
    placement_error: Annotated[float, Field(ge=0)]
    force_limit: Positive


class Lab(_Section):
    """All of a laboratory's numbers."""

    arm: Arm
    gripper: Gripper
    tasks: dict[str, Station]
    twin: Twin

    @cached_property
    def tool(self) -> Floats:
        """The transform (4, 4) from flange to hinge."""
        return kinematics.to_transform(self.arm.tcp)

    def station(self, task: str) -> Station:
        """Return a task's station.

        Raises
        ------
        UsageError
            The laboratory has no such task.
        """
        if task not in self.tasks:
            raise UsageError(f"no station for task {task!r}; the laboratory file has {', '.join(self.tasks)}")
        return self.tasks[task]

    def flange(self, pose: Floats) -> Floats:
        """Return the flange's transform (4, 4) that brings the hinge to a pose (6,)."""
        flange: Floats = kinematics.to_transform(pose) @ np.linalg.inv(self.tool)
        return flange


def load(path: Path | None = None) -> Lab:
    """Read a laboratory file, by default the one that comes with the package.

    Raises
    ------
    UsageError
        No such file, or a value is missing, unknown or out of range; the message names it.
    """
    path = path or DEFAULT
    try:
        return Lab.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise UsageError(f"{path}: cannot read the laboratory file: {error.strerror}") from error
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{path}: not TOML: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise UsageError(f"{path}: {where or 'file'}: {first['msg']}") from error
