"""The engine of each factorization of a batch: L ⊕ V (`light`) or V ⊕ f_v (`view`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.material import Material
from prtcl.factors.visibility import Tracer
from prtcl.scene.bake import Bake, read_mesh_or_bake
from prtcl.scene.frames_engine import Engine, Simple
from prtcl.scene.frames_looks import Looks
from prtcl.scene.frames_view import NOT_TAKEN, ViewEngine
from prtcl.scene.kept_visibility import KeptVisibility
from prtcl.scene.mesh import Mesh

FACTORIZATIONS = ("light", "view")
SAMPLES = 3
"""3 × 3 points a pixel: fixed, where `Scene.render` adapts, so that they are traced once for all lights."""


def engine_for(
    source: Mesh | Bake, materials: Sequence[str | Material | Sequence[str | Material] | None], device: Device, *,
    points: str = "pixel", samples: int | None = None, factorization: str = "light", two_sided: bool = True,
    kept: KeptVisibility | None = None, **settings: float | str | None,
) -> Engine:  # fmt: skip
    """What computes the images of a batch; arguments as for `relight` and `engine_of`.

    Raises
    ------
    InputError
        As `engine_of`.
    """
    given = [name for name in NOT_TAKEN if settings.get(name) is not None]
    if factorization == "view" and given:
        raise InputError(
            f"{given[0]}: is of factorization light, and view has no use for it; leave one of them out"
        )
    mesh, bake = read_mesh_or_bake(source)
    looks = Looks(
        materials, mesh, alone=points == "vertex" or bake is not None,
        baked=None if bake is None else bake.rays, **settings,
    )  # fmt: skip
    return engine_of(
        factorization, mesh, looks, device, points=points, samples=samples, two_sided=two_sided,
        bits=None if bake is None else bake.bits, hard=str(settings.get("hard") or "auto"), kept=kept,
    )  # fmt: skip


def engine_of(
    factorization: str, mesh: Mesh, looks: Looks, device: Device, *, points: str, samples: int | None,
    two_sided: bool, bits: npt.NDArray[np.uint32] | None, hard: str, tracer: Tracer | None = None,
    kept: KeptVisibility | None = None,
) -> Engine:  # fmt: skip
    """The engine of a factorization.

    Parameters
    ----------
    tracer : of the mesh; None makes it
    kept : where visibility is kept; None traces. The others are those of `relight`, and of `Simple` and `ViewEngine`

    Raises
    ------
    InputError
        If there is no such factorization, or it does not take what is asked of it.
    """
    if factorization not in FACTORIZATIONS:
        raise InputError(f"factorization: expected one of {', '.join(FACTORIZATIONS)}, got {factorization!r}")
    if factorization == "light":
        return Simple(
            mesh, looks, device, points=points, samples=SAMPLES if samples is None else samples,
            two_sided=two_sided, bits=bits, tracer=tracer, kept=kept,
        )  # fmt: skip
    if points == "vertex" or bits is not None:
        raise InputError("factorization: view has pixels, no vertices; choose light")
    return ViewEngine(
        mesh, looks, device, samples=samples, two_sided=two_sided, hard=hard, tracer=tracer, kept=kept
    )
