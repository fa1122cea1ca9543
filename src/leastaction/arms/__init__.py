"""Robot arms: inertial parameters and friction from a torque log and a kinematic tree.

Examples
--------
>>> from leastaction import arms
>>> tree = arms.KinematicTree.from_dh([{"a": 0.3}, {"a": 0.2}], modified=False, gravity=(0.0, -9.81, 0.0))
>>> tree.coordinates
('q1', 'q2')
"""

from __future__ import annotations

from leastaction.arms.compare import FreeRuns, TorqueErrors
from leastaction.arms.files import load
from leastaction.arms.identify import identify
from leastaction.arms.log import log_columns, read_log
from leastaction.arms.model import ArmModel
from leastaction.arms.payload import Payload, payload
from leastaction.arms.signals import Recording
from leastaction.library.mjcf import read_mjcf, write_mjcf
from leastaction.library.tree import KinematicTree
from leastaction.library.urdf import read_urdf, write_urdf

__all__ = [
    "ArmModel",
    "FreeRuns",
    "KinematicTree",
    "Payload",
    "Recording",
    "TorqueErrors",
    "identify",
    "load",
    "log_columns",
    "payload",
    "read_log",
    "read_mjcf",
    "read_urdf",
    "write_mjcf",
    "write_urdf",
]
