"""The examples in the sequence in which to read them."""

from __future__ import annotations

from pathlib import Path

_NAMES = (
    "measured_double_pendulum",
    "cart_with_spring",
    "driven_double_pendulum",
    "robot_arm",
    "seven_joint_arm",
    "closed_loop_arm",
    "oscillators",
    "magnetic_pendulum",
    "unknown_anchor",
    "missing_samples",
    "camera_pixels",
    "lacking_term",
    "unmeasured_drive",
    "next_experiment",
    "controller",
)


class Sequence:
    """Sort key of sphinx-gallery; a script without a place of its own comes last."""

    def __init__(self, src_dir: str) -> None:
        self.src_dir = src_dir

    def __call__(self, filename: str) -> tuple[int, str]:
        name = Path(filename).stem
        return (_NAMES.index(name) if name in _NAMES else len(_NAMES), name)
