"""An editing session: geometry stands still, light changes now and then, materials and views all the time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.table import Table
from prtcl.factors.visibility import Progress, Tracer
from prtcl.scene.bake import Bake, read_mesh_or_bake
from prtcl.scene.camera import Camera, Triple
from prtcl.scene.mesh import Mesh
from prtcl.scene.plan_session import SessionPlan, plan_session
from prtcl.scene.points import back_origins, vertex_points
from prtcl.scene.scene import Path, Render, own_materials, read_environment
from prtcl.scene.table_edits import edited
from prtcl.scene.tint import BLACK, Tints, colour_notes
from prtcl.scene.viewfinder import Seen, Viewfinder
from prtcl.transport.edit import Dress, Relit

ERROR = 0.01
"""What the cuts may leave out by default, relative."""
HISTORY = 1000


@dataclass
class Work:
    """What the last view recomputed: only stages that had something to do are in it.

    Attributes
    ----------
    seconds : wall seconds by stage: light, visibility, collapse, cuts, camera_rays, shade, image
    points : points by stage, for those that work on points
    """

    seconds: dict[str, float] = field(default_factory=dict)
    points: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Outfit:
    """Materials ready to shade with: under a white mesh, and what its colour does not multiply (`prtcl.scene.tint`)."""

    full: Dress
    left: Dress | None
    tints: Tints
    draft: bool


class Session:
    """This mesh under this light, its materials and the view free to change.

    Radiance is computed at the mesh's vertices and interpolated over its faces. Visibility and L ⊕ V of a vertex are
    computed when a view first needs them, and kept; after that a change of material or view costs it the leaves of one
    cut of the quadtree, with the BRDF evaluated exactly (`prtcl.transport.cut`), and its hard light.

    Parameters
    ----------
    mesh : a `Mesh`, a path to one, or a `Bake` or a path to one (.npz), whose visibility is then used
    light : an `Environment`, a path to an EXR or HDR map, or an array (h, 2 h, 3)
    material : a SPEC or a `Material` for the whole mesh; a list of one for each part; None takes the mesh's own
    assignment : (n,) int, which of the listed materials each vertex wears, in place of the mesh's parts; between
        vertices of different ones their radiance is interpolated
    camera : the first view; None frames the mesh
    device : None chooses one
    levels : light, visibility and their product live on 4**levels directions
    rays : levels of the visibility grid; None takes `levels`, or what the bake has
    error : relative error that the cuts may cost; 0 takes every sample (exact, slow)
    two_sided : faces seen from behind are shaded on that side; a vertex stands on one side at a time, and is traced and
        collapsed anew when a view sees the other
    smooth : replace normals by vertex normals averaged over the faces

    Attributes
    ----------
    last : Work, what the last view recomputed and how long that took
    plan : SessionPlan, why these levels and rays, or None where they were given

    Examples
    --------
    >>> session = Session("bunny.ply", "sky.exr", "ggx:alpha=0.3,f0=0.04,kd=0.5")  # doctest: +SKIP
    >>> session.material = "ggx:alpha=0.1,eta=0.2,k=3.0"  # doctest: +SKIP
    >>> session.view(eye=(1.0, 0.5, 3.0)).save("gold.exr")  # doctest: +SKIP
    """

    def __init__(
        self,
        mesh: Mesh | Bake | Path,
        light: Environment | Path | npt.NDArray[Any],
        material: str | Material | Sequence[str | Material] | None = None,
        camera: Camera | None = None,
        *,
        assignment: npt.ArrayLike | None = None,
        device: Device | None = None,
        levels: int = 6,
        rays: int | None = None,
        error: float = ERROR,
        two_sided: bool = True,
        smooth: bool = False,
    ) -> None:
        mesh, bake = read_mesh_or_bake(mesh)
        if bake is not None and rays not in (None, bake.rays):
            raise InputError(
                f"rays: the bake has {bake.rays} levels, got {rays}; bake again with --rays {rays}"
            )
        rays = (levels if rays is None else rays) if bake is None else bake.rays
        if not isinstance(levels, int) or not 1 <= levels <= quadtree.MAX_LEVELS:
            raise InputError(f"levels: expected 1 to {quadtree.MAX_LEVELS}, got {levels}")
        if bake is None and not (isinstance(rays, int) and 1 <= rays <= levels):
            raise InputError(f"rays: expected 1 to {levels}, at most levels, got {rays}")
        self.mesh = mesh.smooth() if smooth or mesh.normals is None else mesh
        self.device = device or Device()
        self.camera = camera or Camera.framing(self.mesh.bounds)
        self.notes = list(self.mesh.notes)
        self.last = Work()
        self.plan: SessionPlan | None = None
        self._pending = Work()
        self._snapshots: dict[str, tuple[Material, ...]] = {}
        self._past: list[tuple[Material, ...]] = []
        self._future: list[tuple[Material, ...]] = []
        self._outfit: _Outfit | None = None
        self.tracer = Tracer(self.mesh.vertices, self.mesh.faces)
        self._viewfinder = Viewfinder(self.mesh, self.tracer, two_sided)
        points = vertex_points(self.mesh, self.tracer)
        self._parts = len(self.mesh.materials)
        if assignment is not None:
            self._parts = 1 if material is None or isinstance(material, str | Material) else len(material)
            points = replace(points, material=_checked_assignment(assignment, len(points), self._parts))
            material = "lambert:albedo=0.5" if material is None else material
        self._relit = Relit(
            self.device, self.tracer, self.mesh.vertices, points, back_origins(self.mesh, self.tracer),
            max(levels, rays) if bake is not None else levels, rays, None if bake is None else bake.bits,
        )  # fmt: skip
        self._materials = self._for_parts(material)
        self.notes += colour_notes(self._materials, self.mesh)
        self.error = error
        self.light = light

    @classmethod
    def planned(
        cls,
        mesh: Mesh | Bake | Path,
        light: Environment | Path | npt.NDArray[Any],
        material: str | Material | Sequence[str | Material] | None = None,
        camera: Camera | None = None,
        *,
        error: float,
        device: Device | None = None,
        smooth: bool = False,
        **settings: Any,
    ) -> Session:
        """A session whose vertices' radiance errs by `error` in all, seen from the first view.

        `levels`, `rays` and the cuts' error are chosen by a pilot (`prtcl.scene.plan_session`), unless given; the plan
        is the session's `plan`. Another light or a sharper material may err more: the plan is of those given.

        Raises
        ------
        InputError
            As the constructor's, and if nothing meets the error.
        """
        shape, bake = read_mesh_or_bake(mesh)
        shape = shape.smooth() if smooth or shape.normals is None else shape
        environment, _ = read_environment(light)
        if material is None or isinstance(material, str | Material):
            own = (
                own_materials(shape)
                if material is None
                else [Material.parse(material)] * len(shape.materials)
            )
        else:
            own = [Material.parse(one) for one in material]
        device = device or Device()
        camera = camera or Camera.framing(shape.bounds)
        plan = plan_session(
            shape, environment, own, camera.eye, error, device=device, levels=settings.pop("levels", None),
            rays=settings.pop("rays", None) if bake is None else bake.rays,
        )  # fmt: skip
        session = cls(
            shape if bake is None else bake, environment, material, camera, device=device, levels=plan.levels,
            rays=None if bake is not None else plan.rays, error=plan.error, **settings,
        )  # fmt: skip
        session.plan = plan
        return session

    # --- what changes ---------------------------------------------------------------------------------------

    @property
    def light(self) -> Environment:
        """The environment. Assigning one (or a path, or an array) collapses L ⊕ V anew, of what is then seen."""
        return self._light

    @light.setter
    def light(self, light: Environment | Path | npt.NDArray[Any]) -> None:
        environment, notes = read_environment(light)
        self.notes += notes
        with self._timed("light", self._pending):
            self._relit.set_light(environment)
        self._light, self._outfit = environment, None

    def rotate_light(self, degrees: float) -> None:
        """Turn the light about its up axis to `degrees`, counter-clockwise seen from above."""
        self.light = replace(self._light, rotate=degrees)

    @property
    def materials(self) -> tuple[Material, ...]:
        """One material a part of the mesh."""
        return self._materials

    @property
    def material(self) -> Material:
        """The first part's material. Assigning a SPEC or `Material` dresses all parts in it, a list each part."""
        return self._materials[0]

    @material.setter
    def material(self, material: str | Material | Sequence[str | Material]) -> None:
        self._change(self._for_parts(material))

    def set_material(self, part: int, material: str | Material) -> None:
        """Dress one part of the mesh."""
        if not 0 <= part < len(self._materials):
            raise InputError(f"part: expected 0 to {len(self._materials) - 1}, got {part}")
        new = list(self._materials)
        new[part] = Material.parse(material)
        self._change(tuple(new))

    def edit(self, change: Callable[[Table], Table], part: int | None = None) -> Table:
        """Edit materials as tables: `change` takes each one, tabulated where it is none, and gives another.

        `undo` takes the whole back, in one step.

        Parameters
        ----------
        change : such as ``lambda table: table.sharpened(1.2)``
        part : of the mesh; None edits what all parts wear

        Returns
        -------
        table : of that part, or the first, after the edit

        Raises
        ------
        InputError
            If there is no such part, or the edit is refused: nothing is changed then.
        """
        if part is not None and not 0 <= part < len(self._materials):
            raise InputError(f"part: expected 0 to {len(self._materials) - 1}, got {part}")
        parts = range(len(self._materials)) if part is None else range(part, part + 1)
        materials, table = edited(self._materials, change, parts)
        self._change(materials)
        return table

    def undo(self) -> bool:
        """Take back the last change of materials; False where there is none."""
        return self._step(self._past, self._future)

    def redo(self) -> bool:
        """Do again what `undo` took back; False where there is nothing."""
        return self._step(self._future, self._past)

    def snapshot(self, name: str) -> None:
        """Keep the materials as they are now under a name."""
        self._snapshots[name] = self._materials

    def restore(self, name: str) -> None:
        """Go back to a snapshot; `undo` takes it back."""
        if name not in self._snapshots:
            there = ", ".join(self._snapshots) or "none"
            raise InputError(f"snapshot: no {name!r} was taken; there are: {there}")
        self._change(self._snapshots[name])

    @property
    def snapshots(self) -> tuple[str, ...]:
        """Names of the snapshots taken."""
        return tuple(self._snapshots)

    @property
    def error(self) -> float:
        """Relative error that the cuts may cost; 0 is exact."""
        return self._error

    @error.setter
    def error(self, error: float) -> None:
        if not 0.0 <= error < 1.0:
            raise InputError(f"error: expected 0 or more and below 1, got {error}")
        self._error, self._outfit = float(error), None

    # --- what is seen ---------------------------------------------------------------------------------------

    def view(
        self, camera: Camera | None = None, *, eye: Triple | None = None, samples: int = 1,
        progress: Progress | None = None, draft: bool = False,
    ) -> Render:  # fmt: skip
        """The image from a camera: of all vertices only what it sees is computed.

        Parameters
        ----------
        camera : becomes the session's; None keeps that
        eye : moves the camera, its target kept
        samples : N × N sub-pixel points a pixel
        progress : called with numbers of vertices traced, from worker threads
        draft : while a hand drags: a table edited in `edit` may wear the cut of what it was made of, at a few times the
            error asked for; the next view that is none fits it its own

        Returns
        -------
        render : its report has `seconds` and `points` as `last` has them, and `expected_error`: of the soft light's
            cuts under a white mesh, as measured at a sample of the vertices
        """
        if not isinstance(samples, int) or not 1 <= samples <= 16:
            raise InputError(f"samples: expected 1 to 16 points along a pixel's side, got {samples}")
        self.camera = camera or self.camera
        if eye is not None:
            self.camera = replace(self.camera, eye=eye)
        work = self._begin()
        seen = self._look(samples, work)
        full, left = self._shade(seen.vertices, seen.back, self.camera.eye, work, progress, draft)
        with self._timed("image", work):
            image = self._viewfinder.develop(seen, full, left)
        self.last, settings = work, self._relit.settings
        report = {
            "device": self.device.name,
            "materials": [m.spec for m in self._materials],
            "settings": {"levels": settings.levels, "rays": settings.rays, "error": self._error},
            "expected_error": self._dressed(work, draft).full.error,
            "seconds": dict(work.seconds),
            "points": dict(work.points),
            "notes": self.notes,
        }  # fmt: skip
        return Render(image, report)

    def _look(self, samples: int, work: Work) -> Seen:
        seen = self._viewfinder.known(self.camera, samples)
        if seen is None:
            with self._timed("camera_rays", work):
                seen = self._viewfinder.shoot(self.camera, samples)
        return seen

    def _repr_png_(self) -> bytes:
        """What a notebook shows: the view as it is now."""
        return self.view(samples=2)._repr_png_()

    def waiting(
        self, camera: Camera, samples: int = 1
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.bool_]]:
        """What a view of a camera would have to trace or collapse: vertices (k,), and on which side, True for the back.

        The camera becomes the session's, and what it sees is kept for the view.
        """
        self.camera = camera
        seen = self._look(samples, self._pending)
        which = self._relit.waiting(seen.vertices, seen.back)
        return seen.vertices[which], seen.back[which]

    @property
    def collapsed(self) -> npt.NDArray[np.bool_]:
        """(n,) which vertices are traced and collapsed, on the side that was last seen."""
        return self._relit.collapsed.copy()

    def prepare(self, vertices: npt.NDArray[np.integer], back: npt.NDArray[np.bool_] | None = None) -> None:
        """Trace and collapse vertices ahead of a view; `back` says on which side, None leaves each where it stands."""
        chosen = np.asarray(vertices).astype(np.int32)
        if back is not None:
            self._relit.turn(chosen, back)
        self._relit.trace(chosen)
        self._relit.collapse(chosen)

    def radiance(self, eye: Triple, vertices: npt.ArrayLike | None = None) -> npt.NDArray[np.float32]:
        """Radiance of vertices towards an eye.

        Parameters
        ----------
        vertices : (k,) indices; None is all

        Returns
        -------
        radiance : (k, 3) linear RGB on the side of the normals, the mesh's colour included; 0 where the eye is below
            a vertex's horizon
        """
        count = len(self.mesh.vertices)
        if np.shape(eye) != (3,) or not np.isfinite(np.asarray(eye, dtype=np.float64)).all():
            raise InputError(f"eye: expected three finite numbers, got {eye}")
        chosen = np.arange(count) if vertices is None else np.asarray(vertices).ravel()
        if chosen.size and chosen.dtype.kind not in "iu":
            raise InputError(f"vertices: expected integers, got {chosen.dtype}")
        if chosen.size and (chosen.min() < 0 or chosen.max() >= count):
            raise InputError(f"vertices: expected indices from 0 to {count - 1}")
        work = self._begin()
        front = np.zeros(len(chosen), dtype=np.bool_)
        full, left = self._shade(chosen.astype(np.int32), front, eye, work, None)
        self.last = work
        return full if left is None else left + self.mesh.vertex_colour(chosen) * (full - left)

    def _shade(
        self,
        vertices: npt.NDArray[np.int32],
        back: npt.NDArray[np.bool_],
        eye: Triple,
        work: Work,
        progress: Progress | None,
        draft: bool = False,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32] | None]:
        """Radiance (k, 3) of vertices under a white mesh, and what of it no colour multiplies, if any does."""
        relit = self._relit
        relit.turn(vertices, back)
        stages: tuple[tuple[str, Callable[[], int]], ...] = (
            ("visibility", lambda: relit.trace(vertices, progress)),
            ("collapse", lambda: relit.collapse(vertices)),
        )
        for stage, run in stages:
            start = time.perf_counter()
            count = run()
            if count:
                work.seconds[stage], work.points[stage] = time.perf_counter() - start, count
        outfit = self._dressed(work, draft)
        with self._timed("shade", work):
            work.points["shade"] = len(vertices)
            full = relit.radiance(outfit.full, eye, vertices)
            if not outfit.tints.tinted.any():
                return full, None
            own = relit.points.material[vertices]
            left = np.where(outfit.tints.tinted[own][:, None], np.float32(0), full)
            some = np.flatnonzero(outfit.tints.left[own] >= 0)
            if outfit.left is not None and len(some):
                left[some] = relit.radiance(outfit.left, eye, vertices[some])
            return full, left

    def _dressed(self, work: Work, draft: bool) -> _Outfit:
        if self._outfit is None or (self._outfit.draft and not draft):
            with self._timed("cuts", work):
                tints = Tints(self._materials, self.mesh)
                left = [tints.materials[i] if i >= 0 else BLACK for i in tints.left]
                self._outfit = _Outfit(
                    self._relit.dress(list(self._materials), self._error, draft),
                    self._relit.dress(left, self._error, draft) if (tints.left >= 0).any() else None,
                    tints,
                    draft,
                )
        return self._outfit

    # --- materials and their history ------------------------------------------------------------------------

    def _for_parts(self, material: str | Material | Sequence[str | Material] | None) -> tuple[Material, ...]:
        parts = self._parts
        if material is None:
            return tuple(own_materials(self.mesh))
        if isinstance(material, str | Material) or not isinstance(material, Sequence):
            return (Material.parse(material),) * parts
        if len(material) != parts:
            raise InputError(f"material: expected one, or {parts} for the mesh's parts, got {len(material)}")
        return tuple(Material.parse(m) for m in material)

    def _change(self, materials: tuple[Material, ...]) -> None:
        self._past.append(self._materials)
        del self._past[:-HISTORY]
        self._future.clear()
        self._materials, self._outfit = materials, None

    def _step(self, source: list[tuple[Material, ...]], target: list[tuple[Material, ...]]) -> bool:
        if not source:
            return False
        target.append(self._materials)
        self._materials, self._outfit = source.pop(), None
        return True

    # --- time -----------------------------------------------------------------------------------------------

    def _begin(self) -> Work:
        work, self._pending = self._pending, Work()
        return work

    @contextmanager
    def _timed(self, stage: str, work: Work) -> Iterator[None]:
        start = time.perf_counter()
        yield
        work.seconds[stage] = work.seconds.get(stage, 0.0) + time.perf_counter() - start


def _checked_assignment(given: npt.ArrayLike, vertices: int, materials: int) -> npt.NDArray[np.int32]:
    """Material indices of all vertices.

    Raises
    ------
    InputError
        If there are not as many as vertices, or one is out of range.
    """
    array = np.asarray(given)
    if array.shape != (vertices,) or array.dtype.kind not in "iu":
        raise InputError(
            f"assignment: expected {vertices} integers, one a vertex, got {array.dtype} of shape {array.shape}"
        )
    if array.size and not 0 <= array.min() <= array.max() < materials:
        raise InputError(
            f"assignment: expected from 0 to {materials - 1} for the {materials} materials listed, got {array.max()}"
        )
    return array.astype(np.int32)
