"""`prtcl.fit`: the bivariate table that best explains images of known geometry, light and cameras.

A pixel's radiance is linear in the table (`prtcl.transport.table_rows`): every covered pixel is an equation, and some
thousands of them have the table as their smooth, non-negative, robust least-squares solution
(`prtcl.factors.table_solve`).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.bivariate import Bivariate
from prtcl.factors.environment import Environment
from prtcl.factors.material import Material
from prtcl.factors.slice_operator import SliceOperator
from prtcl.factors.table_solve import solve
from prtcl.factors.visibility import Tracer
from prtcl.files.image import read_image
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh, read_mesh
from prtcl.scene.points import pixel_points, shoot
from prtcl.scene.scene import Path, read_environment
from prtcl.transport.pipeline import Pipeline, Points
from prtcl.transport.settings import Settings
from prtcl.transport.table_rows import hard_rows, soft_rows

Array = npt.NDArray[np.float64]
View = tuple[Camera, "Environment | Path | npt.NDArray[Any]", "Path | npt.NDArray[Any]"]

NODES = 45, 23
PIXELS = 2500
"""Pixels of an image that are used, drawn at random from those the mesh covers whole: more hardly sharpen a table of
a thousand nodes, and the system grows with them."""
POINTS, HARD_POINTS = 4, 16
"""Sub-pixel points of a pixel, of soft light and of its peaks, which vary most and cost least."""
FLAT = 0.5
"""Share of the pixels, those over which the normal turns least, that the used ones are drawn from: few points tell
little of the others, and an error in what is known of a pixel blurs the table."""
RAYS = 5
ROWS_ERROR = 0.005
"""Relative error that a row has at least: a few points of a pixel, cells of directions, nodes of a table."""
UNEXPLAINED = 0.2
"""Residual, relative, from which the notes say so."""
UNSURE = 0.25
"""Relative standard deviation from which a node counts as not determined."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A table, and how well the images are explained by it.

    Attributes
    ----------
    table : its `valid` says which nodes the images determine, by an estimate that takes pixels' errors as independent
        and the smoothness as true: a hint, most of all with few images. The others follow from the smoothness
    residual : relative RMSE of the pixels that were not outliers
    determined : share of the nodes that are
    deviation : (nh, nd) relative standard deviation that the images leave each node
    noise : relative standard deviation of the residuals, robust
    pixels, outliers : how many were used, and how many of them lost all or most of their weight
    iterations : rounds of weights
    notes : what people should know
    """

    table: Bivariate
    residual: float
    determined: float
    deviation: Array
    noise: float
    pixels: int
    outliers: int
    iterations: int
    notes: tuple[str, ...]

    def report(self) -> dict[str, Any]:
        """The numbers of it, for JSON."""
        return {
            "nodes": list(self.table.shape), "residual": self.residual, "determined": self.determined,
            "noise": self.noise, "pixels": self.pixels, "outliers": self.outliers,
            "iterations": self.iterations, "notes": list(self.notes),
        }  # fmt: skip


def default_nodes() -> tuple[Array, Array]:
    """45 nodes of θ_h at equal steps of its root, as MERL's are, and 23 of θ_d at equal steps.

    The second θ_h is 0.05°, the tenth 3.8°. A lobe wants some five nodes to where it has halved: these do for GGX of
    α = 0.05 and wider. What is sharper shows little more than the light's own reflection in images of some hundred
    pixels a side.
    """
    h = np.linspace(0.0, 1.0, NODES[0]) ** 2 * (np.pi / 2)
    return h, np.linspace(0.0, np.pi / 2, NODES[1])


def fit(
    mesh: Mesh | Path,
    views: Sequence[View],
    *,
    theta_h: npt.ArrayLike | None = None,
    theta_d: npt.ArrayLike | None = None,
    smoothness: float = 1.0,
    robust: bool = True,
    levels: int = 6,
    samples: int = PIXELS,
    two_sided: bool = True,
    seed: int = 0,
    device: Device | None = None,
) -> Fit:
    """The bivariate table that best explains images of a mesh of one material.

    Parameters
    ----------
    mesh : a `Mesh` or a path to one
    views : of each image the camera, the light, and the image: (h, w, 3) or (h, w, 4) linear radiance as
        `Scene.render` gives it (colour premultiplied by coverage), or an EXR file; its size is the camera's. Pixels
        of NaN are left out.
    theta_h, theta_d : nodes in radians; None takes `default_nodes`
    smoothness : how much a relative curvature costs; 1 suits noise of about a percent, larger is smoother
    robust : False weighs all pixels alike, outliers too
    levels : light and slices are summed over 4**levels directions
    samples : pixels used of each image, at most
    two_sided : as for `Scene`
    seed : of the choice of pixels
    device : None chooses one

    Raises
    ------
    InputError
        If an image does not fit its camera, no pixel is usable, or a number is out of range.
    PrtclError
        If scipy, the extra `fit`, is not installed.

    Examples
    --------
    >>> found = fit("bunny.ply", [(camera, "sky.exr", "photo.exr")])  # doctest: +SKIP
    >>> found.table.save("bunny.npz")  # doctest: +SKIP
    """
    if not views:
        raise InputError("views: expected at least one (camera, light, image)")
    if not (np.isfinite(smoothness) and smoothness > 0):
        raise InputError(f"smoothness: expected a number above 0, got {smoothness}")
    if samples < 1:
        raise InputError(f"samples: expected at least 1 pixel a view, got {samples}")
    shape = read_mesh(mesh) if isinstance(mesh, str | os.PathLike) else mesh
    device = device or Device()
    own_h, own_d = default_nodes()
    nodes = own_h if theta_h is None else theta_h, own_d if theta_d is None else theta_d
    tracer = Tracer(shape.vertices, shape.faces)
    rng = np.random.default_rng(seed)
    rows, measured, notes = [], [], list(shape.notes)
    lights: dict[int, Environment] = {}
    for number, (camera, source, picture) in enumerate(views, start=1):
        image = _image(picture, camera, number)
        if id(source) not in lights:
            lights[id(source)], more = read_environment(source)
            notes += more
        light = lights[id(source)]
        settings = Settings(levels=levels, rays=min(levels, RAYS), keep=levels)
        pipeline = Pipeline(device, light, [Material.parse("lambert")], settings)
        operator = SliceOperator(device, *nodes, levels, pipeline.channels, 2 if levels < 6 else 1)
        usable, left = _usable(tracer, camera, image, number)
        notes += left
        pixels = _flattest(shape, tracer, camera, usable, samples, rng)
        soft, hard = (
            _points(shape, tracer, camera, pixels, count, two_sided) for count in (POINTS, HARD_POINTS)
        )
        own = soft_rows(pipeline, operator, tracer, soft, POINTS)
        if len(pipeline.light.hard):
            own += hard_rows(pipeline, operator, tracer, hard, HARD_POINTS)
        rows.append(own.astype(np.float32))
        measured.append(image.reshape(-1, image.shape[2])[pixels, :3])
    channels = max(own.shape[1] for own in rows)
    every = np.concatenate([np.broadcast_to(own, (len(own), channels, own.shape[2])) for own in rows])
    b = np.concatenate(measured)
    found = solve(
        every,
        b,
        operator.theta_h,
        operator.theta_d,
        smoothness=smoothness,
        robust=robust,
        least_noise=ROWS_ERROR,
    )
    # Smoothness alone makes any node sure of itself: the images must say something of it, too.
    valid = found.read & (found.deviation < UNSURE) & (found.alone < UNSURE)
    kept = found.weights > 0.25
    residual = float(np.sqrt(((found.predicted - b)[kept] ** 2).mean()) / max(b[kept].mean(), 1e-30))
    outliers = int((~kept).sum())
    if residual > UNEXPLAINED:
        notes.append(
            f"fit: the table leaves {100 * residual:.0f} % of the images unexplained; are meshes, lights and cameras "
            "theirs, and is there one material?"
        )
    if outliers:
        notes.append(f"fit: {outliers} of {len(b)} pixels do not fit the others and were left out")
    if not valid.all():
        notes.append(
            f"fit: {(~valid).sum()} of {valid.size} nodes are not determined by the images; they are filled smoothly"
        )
    table = Bivariate.make(
        found.values, operator.theta_h, operator.theta_d, valid, name="fit", notes=tuple(notes)
    )
    return Fit(
        table, residual, float(valid.mean()), found.deviation, found.noise, len(b), outliers, found.rounds,
        tuple(notes),
    )  # fmt: skip


def _points(
    mesh: Mesh, tracer: Tracer, camera: Camera, pixels: npt.NDArray[np.int64], count: int, two_sided: bool
) -> Points:
    """`count` sub-pixel points of each pixel, all of which hit."""
    pixel, sub = np.repeat(pixels, count), np.tile(np.arange(count), len(pixels))
    hits = shoot(tracer, camera, pixel, sub)
    return pixel_points(mesh, tracer, hits, sub[hits.ray], two_sided)


def _flattest(
    mesh: Mesh, tracer: Tracer, camera: Camera, pixels: npt.NDArray[np.int64], samples: int,
    rng: np.random.Generator,
) -> npt.NDArray[np.int64]:  # fmt: skip
    """Pixels drawn from the share `FLAT` of those over which the normal turns least, at most `samples`, ascending."""
    points = _points(mesh, tracer, camera, pixels, HARD_POINTS, True)
    normals = points.frames[:, 2].reshape(len(pixels), HARD_POINTS, 3)
    length = np.linalg.norm(normals.mean(axis=1), axis=1)  # one where all are the same
    flat = pixels[
        np.argsort(-length, kind="stable")[: max(min(samples, len(pixels)), int(FLAT * len(pixels)))]
    ]
    return np.sort(rng.choice(flat, min(samples, len(flat)), replace=False))


def _image(source: Path | npt.NDArray[Any], camera: Camera, number: int) -> Array:
    """An image (h, w, 3 or 4) of the camera's size."""
    image = source if isinstance(source, np.ndarray) else read_image(source)
    width, height = camera.size
    if image.dtype.kind not in "fiu" or image.ndim != 3 or image.shape[2] not in (3, 4):
        raise InputError(
            f"image {number}: expected (h, w, 3) or (h, w, 4) radiance, got {image.dtype} {image.shape}"
        )
    if image.shape[:2] != (height, width):
        raise InputError(
            f"image {number}: expected {width}x{height} pixels as its camera has, got {image.shape[1]}x{image.shape[0]}"
        )
    return image.astype(np.float64)


def _usable(
    tracer: Tracer, camera: Camera, image: Array, number: int
) -> tuple[npt.NDArray[np.int64], list[str]]:
    """Pixels that the mesh covers whole and that hold numbers, and notes on those that do not.

    A silhouette's pixel is part background: its colour is not the surface's alone.
    """
    width, height = camera.size
    every = np.arange(width * height)
    hit = np.zeros(len(every), np.int64)
    for sub in range(HARD_POINTS):
        hit[shoot(tracer, camera, every, np.full_like(every, sub)).ray] += 1
    flat = image.reshape(-1, image.shape[2])
    covered = hit == HARD_POINTS
    if flat.shape[1] == 4:
        covered &= flat[:, 3] > 0.999
    finite = np.isfinite(flat[:, :3]).all(axis=1)
    usable = np.flatnonzero(covered & finite)
    if not covered.any():
        raise InputError(f"view {number}: the mesh covers no pixel of it whole\nmove its camera")
    if not len(usable):
        raise InputError(f"image {number}: all pixels that the mesh covers are NaN or infinite")
    bad = int((covered & ~finite).sum())
    return usable, [f"image {number}: {bad} pixels are NaN or infinite and were left out"] if bad else []
