"""Materials by name and number: `ggx:alpha=0.3,f0=0.04` and its like, checked and packed for the device."""

from __future__ import annotations

import difflib
import math
import os
from dataclasses import dataclass, field, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.factors import three_angles
from prtcl.files.npz import read_npz

KINDS = ("lambert", "ggx-conductor", "ggx-schlick", "blinn", "table", "measured")
COLOURED_CONDUCTOR = 6
"""Bit of a kernel's KINDS beside those of the kinds (kernels/brdf.clh)."""
N_INTS, N_REALS = 4, 12
"""Lengths of a material's rows on the device (kernels/brdf.clh)."""

FORMS = (
    "lambert:albedo=0.5 | ggx:alpha=0.3,eta=0.2,k=3.0 | ggx:alpha=0.3,f0=0.04[,kd=0.5] | "
    "gltf:base=0.5,roughness=0.5[,metallic=0] | blinn:exponent=200,ks=0.5[,kd=0.1] | table:FILE.npz | "
    "merl:FILE.binary[,angles=2] | rgl:FILE.bsdf[,angles=2] | utia:FILE.bin[,angles=2]"
)
MEASURED = ("merl", "rgl", "utia")
"""Measured formats, each a kind of SPEC."""
LARGEST = 1e30
"""Of a table's values, 1/sr: devices keep them in float32, and multiply them by light."""
MESH = "mesh"
"""A colour that is the mesh's own: albedo=mesh, or kd=0.8*mesh."""
# Parameter: (lowest, highest, default; None must be given). Ranges that conserve energy or are physical.
_PARAMETERS: dict[str, dict[str, tuple[float, float, float | None]]] = {
    "lambert": {"albedo": (0.0, 1.0, 0.5)},
    "ggx-conductor": {
        "alpha": (1e-3, 1.0, None),
        "eta": (1e-3, 100.0, None),
        "k": (0.0, 100.0, None),
        "kd": (0.0, 1.0, 0.0),
    },
    "ggx-schlick": {"alpha": (1e-3, 1.0, None), "f0": (0.0, 1.0, None), "kd": (0.0, 1.0, 0.0)},
    "gltf": {"base": (0.0, 1.0, None), "roughness": (0.0, 1.0, None), "metallic": (0.0, 1.0, 0.0)},
    "blinn": {"exponent": (0.0, 1e5, None), "ks": (0.0, 1.0, None), "kd": (0.0, 1.0, 0.0)},
}
_SCALARS = ("alpha", "exponent", "roughness", "metallic")
_COLOURS = ("albedo", "kd", "f0", "ks", "base")
"""Parameters in which f is linear (or base, of which they are made): those a mesh's colour may multiply."""
_BLACK = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Material:
    """One BRDF: f in 1/sr per RGB channel; the cosine belongs to f_v, not to f.

    Attributes
    ----------
    kind : one of `KINDS`
    numbers : parameter to RGB triple (`alpha` and `exponent` to one number)
    table : None, or {"values": (nh, nd, 3), "theta_h": (nh,), "theta_d": (nd,)} float64, angles in radians; of
        kind "measured", values are (nh, nd, np, 3), with "valid" (nh, nd, np) beside them, 1 for a measured sample
    spec : the text it came from, for messages and reports
    tints : parameter to the share (RGB) of it that the mesh's colour multiplies, from 0 to 1; empty for most
    notes : warnings for people, such as negative table entries set to zero
    like : the table that this one is an edit of, whose cut may serve it (`prtcl.transport.edit`); None for most
    """

    kind: str
    numbers: dict[str, Any]
    table: dict[str, npt.NDArray[np.float64]] | None = None
    spec: str = ""
    notes: tuple[str, ...] = ()
    tints: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    like: Material | None = None

    @classmethod
    def parse(cls, spec: str | Material) -> Material:
        """A material from its SPEC (see `FORMS`); a number may be r/g/b, and a colour `mesh` or such as `0.8*mesh`.

        Raises
        ------
        InputError
            Naming what in the SPEC is wrong, what was expected, and the forms there are.
        """
        if isinstance(spec, Material):
            return spec
        if not isinstance(spec, str):
            raise InputError(f"brdf: expected a text such as 'lambert:albedo=0.5', got {spec!r}")
        name, _, rest = spec.partition(":")
        if name == "table":
            return _read_table(rest, spec)
        if name in MEASURED:
            from prtcl.factors.measured_files import read_spec  # which makes materials of what it reads

            return read_spec(spec)
        given = _assignments(spec, rest)
        _refuse_unknown(spec, name, given)
        if name == "ggx":
            if ("f0" in given) == ("eta" in given or "k" in given):
                raise InputError(f"brdf {spec}: expected f0, or both eta and k\nforms: {FORMS}")
            name = "ggx-schlick" if "f0" in given else "ggx-conductor"
        elif name not in ("lambert", "blinn", "gltf"):
            raise InputError(f"brdf {spec}: unknown kind {name!r}\nforms: {FORMS}")
        numbers: dict[str, Any] = {}
        tinted = []
        for parameter, (low, high, default) in _PARAMETERS[name].items():
            text = given.pop(parameter, None)
            if text is None and default is None:
                raise InputError(f"brdf {spec}: {parameter} is missing\nforms: {FORMS}")
            if text is not None and parameter in _COLOURS and (text == MESH or text.endswith("*" + MESH)):
                tinted.append(parameter)
                text = "1" if text == MESH else text[: -len(MESH) - 1]
            value = (default,) * 3 if text is None else _number(spec, parameter, text)
            if not all(math.isfinite(v) and low <= v <= high for v in value):  # type: ignore[arg-type, operator]
                raise InputError(f"brdf {spec}: {parameter} expected from {low:g} to {high:g}, got {text}")
            if parameter in _SCALARS and len(set(value)) > 1:
                raise InputError(f"brdf {spec}: {parameter} expected one number, got {text}")
            numbers[parameter] = value[0] if parameter in _SCALARS else value
        if name == "gltf":
            base, metallic, roughness = (numbers[key] for key in ("base", "metallic", "roughness"))
            return replace(cls.from_metallic_roughness(base, metallic, roughness, bool(tinted)), spec=spec)
        return cls(name, numbers, spec=spec, tints={parameter: (1.0,) * 3 for parameter in tinted})

    @classmethod
    def from_metallic_roughness(
        cls, base_color: tuple[float, float, float], metallic: float, roughness: float, mesh: bool = False
    ) -> Material:
        """glTF 2.0's metallic-roughness material (appendix B): α = roughness², F0 = mix(0.04, base, metallic).

        Parameters
        ----------
        base_color : linear; times the mesh's own colour where `mesh`
        """
        f0 = tuple(0.04 * (1 - metallic) + metallic * min(1.0, c) for c in base_color)
        kd = tuple((1 - metallic) * min(1.0, c) for c in base_color)
        alpha = min(1.0, max(1e-3, roughness**2))
        text = "/".join(f"{v:.4g}" for v in f0)
        diffuse = "/".join(f"{v:.4g}" for v in kd)
        if mesh:
            base = "/".join(f"{v:.4g}" for v in base_color)
            share = [
                metallic * min(1.0, c) / v if v > 0 else 0.0 for c, v in zip(base_color, f0, strict=True)
            ]
            return cls(
                "ggx-schlick",
                {"alpha": alpha, "f0": f0, "kd": kd},
                spec=f"gltf:base={base}*mesh,roughness={roughness:.4g},metallic={metallic:.4g}",
                tints={"kd": (1.0, 1.0, 1.0), "f0": (share[0], share[1], share[2])},
            )
        return cls(
            "ggx-schlick",
            {"alpha": alpha, "f0": f0, "kd": kd},
            spec=f"ggx:alpha={alpha:.4g},f0={text},kd={diffuse}",
        )

    @property
    def untinted(self) -> Material:
        """What of it the mesh's colour does not multiply.

        f is linear in what `tints` names, so with this one's radiance L₀ and its own L₁, under a white mesh, a point
        of colour c reflects L₀ + c (L₁ − L₀).
        """
        numbers = dict(self.numbers)
        for parameter, share in self.tints.items():
            numbers[parameter] = tuple(v * (1.0 - s) for v, s in zip(numbers[parameter], share, strict=True))
        return replace(self, numbers=numbers, spec=f"{self.spec} without {MESH}", tints={})

    @property
    def black(self) -> bool:
        """Whether it reflects nothing."""
        if self.table is not None:
            return not self.table["values"].any()
        if self.kind.startswith("ggx"):
            return False  # Schlick's Fresnel term is 1 at grazing angles whatever f0 is
        return not any(any(self.numbers.get(name, _BLACK)) for name in ("albedo", "kd", "ks"))

    @property
    def grey(self) -> bool:
        """Whether its three channels are the same."""
        if self.table is not None:
            values = self.table["values"]
            return bool((values == values[..., :1]).all())
        return all(len(set(v)) == 1 for v in self.numbers.values() if isinstance(v, tuple))

    @property
    def roughness(self) -> float:
        """GGX α of a lobe about as wide as this material's sharpest; 1 for a diffuse one.

        It decides how fine a hemisphere must be. Blinn's exponent n corresponds to α = √(2/(n + 2)) (Walter et
        al. 2007, section 5); a table's lobe is taken where it has fallen to half its peak, at which GGX has
        tan²θ_h = (√2 − 1) α² / (1 − √2 α²).
        """
        if self.kind.startswith("ggx"):
            return float(self.numbers["alpha"])
        if self.kind == "blinn":
            return min(1.0, math.sqrt(2.0 / (self.numbers["exponent"] + 2.0)))
        if self.table is not None:
            return _table_roughness(self.table)
        return 1.0

    def reference(self) -> dict[str, object]:
        """The same material as `prtcl.reference.brdf` takes it."""
        if self.table is not None:
            return {"kind": self.kind, **self.table}
        return {"kind": self.kind.split("-")[0], **self.numbers}


_ENTRIES: WeakKeyDictionary[Material, tuple[npt.NDArray[np.float64], ...]] = WeakKeyDictionary()
"""Measured tables as they are packed: a session packs its materials at every edit, and MERL's are 6 million numbers."""


def pack(
    materials: list[Material],
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Rows of ints and reals, and the tables one after another, as kernels/brdf.clh reads them.

    Returns
    -------
    ints : (n, 4) int32; reals : (n, 12) float64; tables : (any,) float64, at least one entry
    """
    ints = np.zeros((len(materials), N_INTS), dtype=np.int32)
    reals = np.zeros((len(materials), N_REALS))
    tables: list[npt.NDArray[np.float64]] = []
    offset = 0
    for row, material in enumerate(materials):
        numbers = material.numbers
        ints[row, 0] = KINDS.index(material.kind)
        reals[row, 0:3] = numbers.get("kd", numbers.get("albedo", 0.0))
        reals[row, 3] = numbers.get("alpha", numbers.get("exponent", 0.0))
        reals[row, 4:7] = numbers.get("f0", numbers.get("eta", numbers.get("ks", 0.0)))
        reals[row, 7:10] = numbers.get("k", 0.0)
        if material.table is not None:
            if material.kind == "measured":
                if material not in _ENTRIES:
                    _ENTRIES[material] = three_angles.entries(material.table)
                grids = _ENTRIES[material]
                reals[row, 3] = grids[2].shape[2]
            else:
                theta_h, theta_d, values = (material.table[key] for key in ("theta_h", "theta_d", "values"))
                grids = theta_h, theta_d, values
            parts = [grid.ravel() for grid in grids]
            ints[row, 1:] = offset, parts[0].size, parts[1].size
            tables += parts
            offset += sum(part.size for part in parts)
    return ints, reals, np.concatenate(tables) if tables else np.zeros(1)


def anchored(spec: str, folder: str) -> str:
    """The SPEC with the file it names, if any, found from a folder where its path is relative."""
    kind, _, rest = spec.partition(":")
    return f"{kind}:{os.path.join(folder, rest)}" if rest and kind in ("table", *MEASURED) else spec


def _assignments(spec: str, text: str) -> dict[str, str]:
    given: dict[str, str] = {}
    for part in filter(None, text.split(",")):
        key, equals, value = part.partition("=")
        if not equals or not value:
            raise InputError(f"brdf {spec}: expected name=number, got {part!r}\nforms: {FORMS}")
        if key.strip() in given:
            raise InputError(f"brdf {spec}: {key.strip()} is given twice")
        given[key.strip()] = value.strip()
    return given


def _refuse_unknown(spec: str, name: str, given: dict[str, str]) -> None:
    """Name a misspelt parameter before another one is missed for it. Either form of ggx may be meant here."""
    kinds = [kind for kind in _PARAMETERS if kind.split("-")[0] == name]
    if name == "ggx" and "f0" in given and not {"eta", "k"} & given.keys():
        kinds = ["ggx-schlick"]
    known = list(dict.fromkeys(parameter for kind in kinds for parameter in _PARAMETERS[kind]))
    for parameter in given:
        if kinds and parameter not in known:
            # 0.5 takes one slip in a short name such as f0 or kd; case is a slip too.
            close = difflib.get_close_matches(parameter.lower(), known, n=1, cutoff=0.5)
            meant = f"did you mean {close[0]}? " if close else ""
            raise InputError(
                f"brdf {spec}: unknown parameter {parameter!r}; {meant}{name} knows {', '.join(known)}"
            )


def _number(spec: str, parameter: str, text: str) -> tuple[float, ...]:
    try:
        value = tuple(float(part) for part in text.split("/"))
    except ValueError:
        value = ()
    if len(value) not in (1, 3):
        raise InputError(f"brdf {spec}: {parameter} expected a number or r/g/b, got {text!r}")
    return value * 3 if len(value) == 1 else value


def _read_table(path: str, spec: str) -> Material:
    """values[nh, nd, 3], theta_h[nh], theta_d[nd] from an .npz."""
    if not path:
        raise InputError(f"brdf {spec}: expected table:FILE.npz")
    found = read_npz(path, "a table of values, theta_h and theta_d")
    missing = [key for key in ("values", "theta_h", "theta_d") if key not in found]
    if missing:
        there = ", ".join(found) or "nothing"
        raise InputError(f"{path}: expected arrays values, theta_h and theta_d, found {there}")
    return from_table(found["values"], found["theta_h"], found["theta_d"], name=path, spec=spec)


def from_table(
    values: npt.ArrayLike,
    theta_h: npt.ArrayLike,
    theta_d: npt.ArrayLike,
    *,
    name: str = "table",
    spec: str = "",
) -> Material:
    """A bivariate table f̃(θ_h, θ_d), bilinear between its nodes and clamped outside.

    Parameters
    ----------
    values : (nh, nd, 3) or (nh, nd), 1/sr, finite; negative entries become 0 and are noted
    theta_h, theta_d : (nh,), (nd,) node angles in radians, ascending, from 0 to π/2

    Raises
    ------
    InputError
        If shapes do not fit, or a value or an angle is not finite, or the nodes do not ascend.
    """
    try:
        given = [np.asarray(array) for array in (values, theta_h, theta_d)]
    except ValueError as error:  # rows of different lengths
        raise InputError(f"{name}: expected rectangular arrays ({error})") from error
    if any(array.dtype.kind not in "fiu" for array in given):
        kinds = ", ".join(str(array.dtype) for array in given)
        raise InputError(f"{name}: expected arrays of real numbers, got {kinds}")
    table, *nodes = (array.astype(np.float64) for array in given)
    if table.ndim == 2:
        table = np.repeat(table[..., None], 3, axis=2)
    if table.ndim != 3 or table.shape[2] != 3 or any(n.ndim != 1 or n.size < 1 for n in nodes):
        raise InputError(f"{name}: expected values[nh, nd, 3] and two node lists, got values {table.shape}")
    if table.shape[:2] != (nodes[0].size, nodes[1].size):
        raise InputError(
            f"{name}: values {table.shape} do not fit theta_h[{nodes[0].size}] and theta_d[{nodes[1].size}]"
        )
    for key, angles in zip(("theta_h", "theta_d"), nodes, strict=True):
        if not np.isfinite(angles).all() or (np.diff(angles) <= 0).any():
            raise InputError(f"{name}: {key} expected finite, strictly ascending angles in radians")
        if angles[0] < 0 or angles[-1] > np.pi / 2 + 1e-6:
            raise InputError(
                f"{name}: {key} expected angles from 0 to pi/2 radians, got {angles[0]:g} to {angles[-1]:g}"
                + ("; are they degrees?" if angles[-1] > 2 else "")
            )
    bad = ~np.isfinite(table)
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(f"{name}: {int(bad.sum())} values are NaN or infinite, the first at {first}")
    if np.abs(table).max(initial=0.0) > LARGEST:
        raise InputError(f"{name}: values expected below {LARGEST:g} 1/sr, got up to {np.abs(table).max():g}")
    notes: tuple[str, ...] = ()
    negative = int((table < 0).sum())
    if negative:
        notes = (f"{name}: {negative} of {table.size} table values are negative; they are taken as 0",)
    return Material(
        "table",
        {},
        table={"values": np.maximum(table, 0.0), "theta_h": nodes[0], "theta_d": nodes[1]},
        spec=spec or name,
        notes=notes,
    )


def _table_roughness(table: dict[str, npt.NDArray[np.float64]]) -> float:
    # Over the channels and, where there are any, over the bins of φ_d.
    profile = table["values"].mean(axis=tuple(range(2, table["values"].ndim)))
    sharpest = 1.0
    for column in profile.T:
        fallen = np.nonzero(column < 0.5 * column[0])[0]
        if column[0] > 0 and fallen.size:
            tan = math.tan(min(table["theta_h"][fallen[0]], 1.5))
            sharpest = min(sharpest, tan / math.sqrt(math.sqrt(2) - 1 + math.sqrt(2) * tan**2))
    return max(sharpest, 1e-3)
