"""All-frequency relighting and material editing with 2D Haar wavelets on OpenCL.

`Scene` is the way in: this mesh, this light, this material, from here. The stages it is made of (`haar`, `triple`,
`visibility`, `environment`, `brdf`, `shade`) work on their own arrays too; `prtcl.reference` is the same in float64
NumPy. Importing prtcl starts nothing: the first call that needs a device does.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from prtcl._version import __version__

if TYPE_CHECKING:
    from prtcl.compute.choice import devices as devices
    from prtcl.compute.device import Device as Device
    from prtcl.errors import InputError as InputError
    from prtcl.errors import PrtclError as PrtclError
    from prtcl.factors.environment import Environment as Environment
    from prtcl.factors.material import Material as Material
    from prtcl.factors.sky import sun_sky as sun_sky
    from prtcl.factors.table import Table as Table
    from prtcl.scene.bake import Bake as Bake
    from prtcl.scene.camera import Camera as Camera
    from prtcl.scene.camera_path import View as View
    from prtcl.scene.camera_path import turntable as turntable
    from prtcl.scene.fit import fit as fit
    from prtcl.scene.frames import Frame as Frame
    from prtcl.scene.frames import relight as relight
    from prtcl.scene.mesh import Mesh as Mesh
    from prtcl.scene.mesh import read_mesh as read_mesh
    from prtcl.scene.scene import Render as Render
    from prtcl.scene.scene import Scene as Scene
    from prtcl.scene.session import Session as Session
    from prtcl.stages import brdf as brdf
    from prtcl.stages import environment as environment
    from prtcl.stages import haar as haar
    from prtcl.stages import ihaar as ihaar
    from prtcl.stages import shade as shade
    from prtcl.stages import triple as triple
    from prtcl.stages import visibility as visibility
    from prtcl.stages import visibility_haar as visibility_haar

_HOMES = {
    "prtcl.compute.choice": ("devices",),
    "prtcl.compute.device": ("Device",),
    "prtcl.errors": ("InputError", "PrtclError"),
    "prtcl.factors.environment": ("Environment",),
    "prtcl.factors.material": ("Material",),
    "prtcl.factors.sky": ("sun_sky",),
    "prtcl.factors.table": ("Table",),
    "prtcl.scene.bake": ("Bake",),
    "prtcl.scene.camera": ("Camera",),
    "prtcl.scene.camera_path": ("View", "turntable"),
    "prtcl.scene.fit": ("fit",),
    "prtcl.scene.frames": ("Frame", "relight"),
    "prtcl.scene.mesh": ("Mesh", "read_mesh"),
    "prtcl.scene.scene": ("Render", "Scene"),
    "prtcl.scene.session": ("Session",),
    "prtcl.stages": (
        "brdf",
        "environment",
        "haar",
        "ihaar",
        "shade",
        "triple",
        "visibility",
        "visibility_haar",
    ),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'prtcl' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
