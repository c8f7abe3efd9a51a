"""The environment: an equirectangular radiance map, its orientation, and its split into soft and hard light.

A hard sun breaks uniform sampling: half of an outdoor map's energy can sit in 2·10⁻⁴ sr, a fraction of one
sample's solid angle. So the map is taken apart once: what exceeds a radiance threshold becomes *hard samples*
(`prtcl.factors.hardlight`), traced and shaded exactly; what is left is *soft*, bounded by the threshold, and is
prefiltered onto a cube from which `kernels/environment.cl` gathers L_n. The two parts add up to the map.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl.compute.device import Device
from prtcl.compute.tuning import Form, Tunable
from prtcl.errors import InputError
from prtcl.factors import hardlight, hemisphere

GROUP = 64
SUB = 0
"""Levels of subsamples a cell is averaged over. The cube is filtered to the cell's own size, so one look-up is
its average. Four look-ups into a cube twice as fine gave the same error in one trial against Mitsuba, for four times
the work; no committed script repeats that trial yet."""
GATHER = Tunable("environment", (Form("cells"), Form("wide")), cpu=Form("wide"), gpu=Form("cells"))
"""A work-item a cell (environment.cl), or vectors of cells (environment_wide.cl)."""
HARD_LEVELS = 6
"""The grid whose cells the threshold is set for: a cell of it may hold at most `HARD_SHARE` of the mean
irradiance, so that its place inside the cell cannot matter more than that."""
HARD_SHARE = 0.001


@dataclass(frozen=True, eq=False)
class _Parts:
    """Soft cube and hard samples on the axes of the map `image`, as `Light` describes them."""

    image: npt.NDArray[np.float32]
    cube: npt.NDArray[np.float32]
    hard: npt.NDArray[np.float64]
    hard_share: float


@dataclass(frozen=True, eq=False)
class Environment:
    """An equirectangular map over the world's directions.

    Parameters
    ----------
    image : (h, 2 h, 3) float32 radiance, linear, row 0 at the zenith; texel centres at (i + 0.5)/h,
        (j + 0.5)/w; u = atan2(x, −z)/2π, v = acos(y)/π; bilinear between texels, columns wrapping
    rotate : degrees about the up axis, counter-clockwise seen from above
    up : "y", or "z" for a scene whose up axis is z
    name : for messages

    Raises
    ------
    InputError
        If the image is not (h, 2 h, 3), not finite or negative, or `up` is neither y nor z.
    """

    image: npt.NDArray[np.float32]
    rotate: float = 0.0
    up: str = "y"
    name: str = "environment"
    _parts: dict[tuple[int, str, int, float, float], _Parts] = field(default_factory=dict, repr=False)
    """What `split` made on the map's own axes; `dataclasses.replace` hands it on, so a turned map is not split anew."""

    def __post_init__(self) -> None:
        shape = np.shape(self.image)
        if len(shape) != 3 or shape[2] != 3 or shape[1] != 2 * shape[0]:
            raise InputError(
                f"{self.name}: expected an equirectangular map of shape (h, 2 h, 3), got {shape}"
            )
        if not np.isfinite(self.image).all() or (np.asarray(self.image) < 0).any():
            raise InputError(f"{self.name}: expected finite radiance, 0 or more")
        if self.up not in ("y", "z"):
            raise InputError(f"env-up: expected y or z, got {self.up!r}")
        if not math.isfinite(self.rotate):
            raise InputError(f"env-rotate: expected degrees, got {self.rotate}")

    @classmethod
    def constant(cls, radiance: float | tuple[float, float, float] = 1.0) -> Environment:
        """The same radiance from everywhere: the white furnace."""
        image = np.empty((2, 4, 3), dtype=np.float32)
        image[:] = radiance
        return cls(image, name="constant")

    @property
    def to_map(self) -> npt.NDArray[np.float64]:
        """(3, 3) rotation that takes world directions (columns) to the map's own Y-up directions."""
        angle = math.radians(self.rotate)
        c, s = math.cos(angle), math.sin(angle)
        undo = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])  # about +y by −angle
        if self.up == "z":
            undo = undo @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        return undo

    @property
    def host_bytes(self) -> int:
        """Of the map, and of what `split` has made of it."""
        parts = list(self._parts.values())  # another thread may be at it
        return int(self.image.nbytes) + sum(own.cube.nbytes + own.hard.nbytes for own in parts)

    def texel_solid_angles(self) -> npt.NDArray[np.float64]:
        """Solid angle of one texel of every row: (h,) sr."""
        height = self.image.shape[0]
        edges = np.cos(np.pi * np.arange(height + 1) / height)
        return (edges[:-1] - edges[1:]) * (2 * np.pi / (2 * height))

    def split(
        self, levels: int, hard: str = "auto", max_samples: int = hardlight.MAX_SAMPLES,
        share: float = HARD_SHARE, spread: float = hardlight.SPREAD,
    ) -> Light:  # fmt: skip
        """Soft cube and hard samples for hemispheres of 4**levels cells.

        Parameters
        ----------
        levels : of the hemisphere grid the light will be gathered on
        hard : "auto" takes hard light out where there is any, "off" leaves everything in the map
        max_samples : at most so many hard samples
        share : of the mean irradiance, what a cell of `HARD_LEVELS` may hold before its light is hard
        spread : as `hardlight.SPREAD`

        Returns
        -------
        light : Light
        """
        key = (levels, hard, max_samples, share, spread)
        if key not in self._parts or self._parts[key].image is not self.image:
            self._parts[key] = self._split(*key)
        parts = self._parts[key]
        world = parts.hard.copy()
        world[:, :3] = parts.hard[:, :3] @ self.to_map  # rows times the matrix: its transpose, map to world
        return Light(
            cube=parts.cube, hard=world, to_map=self.to_map, levels=levels, hard_share=parts.hard_share
        )

    def _split(self, levels: int, hard: str, max_samples: int, share: float, spread: float) -> _Parts:
        """`split` on the map's own axes."""
        image = np.asarray(self.image, dtype=np.float64)
        solid = self.texel_solid_angles()
        mean = float((image.mean(axis=2) * solid[:, None]).sum() / (4 * np.pi))
        threshold = share * np.pi * mean / (2 * np.pi / 4**HARD_LEVELS)
        face = cube_face(levels)
        if hard == "off" or not (image.mean(axis=2).max() > threshold > 0.0):
            threshold = np.inf
        bright = hardlight.candidates(image, threshold)
        # Subtexels must be finer than the cube's texels (2/face rad), or the splat would leave holes.
        refine = max(1, math.ceil(np.pi / image.shape[0] * face))
        parts = hardlight.subtexel_bands(image, ~bright, refine)
        lights = np.zeros((0, 6))
        if bright.any():
            rows, columns = np.nonzero(bright)
            fine = hardlight.subtexels(image, rows, columns, max(refine, hardlight.REFINE))
            soft, excess = hardlight.clip(fine.radiance, threshold)
            lights = hardlight.cluster(
                fine.directions, excess * fine.solid_angles[:, None], max_samples, spread
            )
            parts = chain(parts, [hardlight.Subtexels(fine.directions, soft, fine.solid_angles)])
        total = float((image.sum(axis=2) * solid[:, None]).sum())
        held = float(lights[:, 3:].sum()) / total if total else 0.0
        return _Parts(self.image, splat_cube(parts, face), lights, held)


@dataclass(frozen=True, eq=False)
class Light:
    """An environment ready for the device.

    Attributes
    ----------
    cube : (6, face + 2, face + 2, 4) float32 soft radiance on the map's own axes (kernels/environment.cl)
    hard : (k, 6) float64: world direction, irradiance at normal incidence (RGB)
    to_map : (3, 3) rotation from world to map directions
    levels : of the hemisphere grid it was made for
    hard_share : fraction of the map's energy that the hard samples hold
    """

    cube: npt.NDArray[np.float32]
    hard: npt.NDArray[np.float64]
    to_map: npt.NDArray[np.float64]
    levels: int
    hard_share: float
    _buffers: dict[Device, tuple[Any, Any]] = field(default_factory=dict, repr=False)

    @property
    def grey(self) -> bool:
        """Whether red, green and blue are the same everywhere."""
        soft = self.cube[..., :3]
        return bool((soft == soft[..., :1]).all() and (self.hard[:, 3:] == self.hard[:, 3:4]).all())

    def buffers(self, device: Device) -> tuple[Any, Any]:
        """Cube and hard samples (k, 2, 4) on the device, uploaded once."""
        if device not in self._buffers:
            lights = np.zeros((max(1, len(self.hard)), 2, 4))
            if len(self.hard):
                lights[:, 0, :3], lights[:, 1, :3] = self.hard[:, :3], self.hard[:, 3:]
            self._buffers[device] = (device.array(self.cube), device.array(lights))
        return self._buffers[device]


def cube_face(levels: int) -> int:
    """Texels along a cube's face whose spacing is that of the look-ups, 4**(levels + SUB) a hemisphere."""
    return math.ceil(2.0 / math.sqrt(2 * np.pi / 4.0 ** (levels + SUB)))


def _cube_coordinates(
    directions: npt.NDArray[np.float64],
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Face (+x −x +y −y +z −z) and its two coordinates in [−1, 1]: the other axes in cyclic order."""
    axis = np.argmax(np.abs(directions), axis=1)
    rows = np.arange(len(directions))
    major = directions[rows, axis]
    s = directions[rows, (axis + 1) % 3] / np.abs(major)
    t = directions[rows, (axis + 2) % 3] / np.abs(major)
    return 2 * axis + (major < 0), s, t


def splat_cube(parts: Iterable[hardlight.Subtexels], face: int) -> npt.NDArray[np.float32]:
    """Soft radiance on a cube: every subtexel is spread bilinearly over its four texels.

    A texel is the energy it received over the solid angle it received, so a constant map stays constant to
    rounding and nothing smaller than a texel is lost between samples.
    """
    count = 6 * face * face
    sums = np.zeros((4, count))
    for part in parts:
        which, s, t = _cube_coordinates(part.directions)
        x, y = (s + 1) / 2 * face - 0.5, (t + 1) / 2 * face - 0.5
        x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        for dx in (0, 1):
            for dy in (0, 1):
                weight = np.abs(1 - dx - (x - x0)) * np.abs(1 - dy - (y - y0)) * part.solid_angles
                i, j = np.clip(x0 + dx, 0, face - 1), np.clip(y0 + dy, 0, face - 1)
                texel = (which * face + j) * face + i
                sums[3] += np.bincount(texel, weight, count)
                for c in range(3):
                    sums[c] += np.bincount(texel, weight * part.radiance[:, c], count)
    inner = (sums[:3] / np.maximum(sums[3], 1e-300)).T.reshape(6, face, face, 3)
    cube = np.zeros((6, face + 2, face + 2, 4), dtype=np.float32)
    cube[:, 1:-1, 1:-1, :3] = inner
    _fill_border(cube, inner, face)
    return cube


def _fill_border(cube: npt.NDArray[np.float32], inner: npt.NDArray[np.float64], face: int) -> None:
    """The texels just beyond a face's edge are those of its neighbours along the same directions."""
    centre = (np.arange(face + 2) - 0.5) / face * 2 - 1
    t, s = np.meshgrid(centre, centre, indexing="ij")
    outside = (np.abs(s) > 1) | (np.abs(t) > 1)
    for which in range(6):
        axis, sign = which // 2, -1.0 if which % 2 else 1.0
        directions = np.empty((int(outside.sum()), 3))
        directions[:, axis] = sign
        directions[:, (axis + 1) % 3] = s[outside]
        directions[:, (axis + 2) % 3] = t[outside]
        # On the exact diagonal two axes tie; shrink the own axis so that the neighbour wins.
        directions[:, axis] *= 1 - 1e-9
        other, u, v = _cube_coordinates(directions)
        i = np.clip(((u + 1) / 2 * face).astype(np.int64), 0, face - 1)
        j = np.clip(((v + 1) / 2 * face).astype(np.int64), 0, face - 1)
        cube[which][outside, :3] = inner[other, j, i]


def gather(
    device: Device, light: Light, frames: Any, *, channels: int = 3, splat_hard: bool = False, out: Any = None
) -> Any:
    """L_n = R_n L for every point: soft radiance averaged over each cell of its hemisphere.

    Parameters
    ----------
    frames : (n, 3, 3) world frames, host or device, rows tangent, bitangent, normal
    channels : 3, or 1 where the light is grey
    splat_hard : add the hard samples to the cells they fall in, so that all energy is in the grid
    out : device array (n, channels, 4**levels) or None

    Returns
    -------
    samples : device array (n, channels, 4**levels) in Morton order
    """
    cube, hard = light.buffers(device)
    levels, count = light.levels, len(frames)
    map_frames = frames_on_map(device, light, frames)
    out = device.empty((count, channels, 4**levels)) if out is None else out
    face = cube.shape[1] - 2
    if GATHER.of(device).name == "wide" and levels >= 2 and SUB == 0:
        wide = device.kernels("environment_wide.cl", LEVELS=levels, CHANNELS=channels)[
            "environment_gather_wide"
        ]
        planes = direction_planes(device, levels)
        device.launch(wide, count, 1, cube, face, planes, map_frames, out, stage="environment_gather")
    else:
        kernel = _kernels(device, levels, channels)["environment_gather"]
        directions = look_up_directions(device, levels)
        device.launch(kernel, 4**levels, GROUP, cube, face, directions, map_frames, out, y=count)
    if splat_hard and len(light.hard):
        kernels = _kernels(device, levels, channels)
        world_frames = device.array(frames)
        device.launch(
            kernels["environment_splat"], count, GROUP, hard, len(light.hard), world_frames, out, count
        )
    return out


def _kernels(device: Device, levels: int, channels: int) -> dict[str, Any]:
    return device.kernels("environment.cl", LEVELS=levels, CHANNELS=channels, SUB=SUB, GROUP=GROUP)


def frames_on_map(device: Device, light: Light, frames: Any) -> Any:
    """World frames (n, 3, 3) turned onto the map's axes, on the device."""
    host = frames.get() if hasattr(frames, "base_data") else np.asarray(frames)
    return device.array(host.reshape(-1, 3, 3) @ light.to_map.T)


def look_up_directions(device: Device, levels: int) -> Any:
    """Local directions of the look-ups, (4**(levels + SUB), 4) on the device."""
    return device.constant(("directions", levels + SUB), lambda: hemisphere.directions(levels + SUB))


def direction_planes(device: Device, levels: int) -> Any:
    """Local directions of the cells, one look-up each, as planes x, y, z: (3, 4**levels) on the device."""
    return device.constant(("planes", levels), lambda: hemisphere.directions(levels)[:, :3].T)
