"""Measured BRDF files by SPEC: `merl:FILE.binary`, `rgl:FILE.bsdf`, `utia:FILE.bin`, each read into `Measured`.

Three angles are the default, since they are what was measured; `,angles=2` makes the bivariate table, which can be
edited. Either way the notes say how far apart the two are.
"""

from __future__ import annotations

import os
import re
from dataclasses import replace

from prtcl.errors import InputError
from prtcl.factors.adaptive import LEAST_COSINE, Adaptive, to_rgb
from prtcl.factors.bivariate import Bivariate
from prtcl.factors.material import FORMS, MEASURED, Material
from prtcl.factors.measured import Measured, merl_layout
from prtcl.factors.reduction import reciprocity_error, reduction_error
from prtcl.factors.turned import LEAST_COSINE as MEASURED_TO
from prtcl.factors.turned import Turned
from prtcl.files.merl import read_merl
from prtcl.files.rgl import read_rgl
from prtcl.files.source import check_source
from prtcl.files.utia import read_utia

EXTENSIONS = {".binary": "merl", ".bsdf": "rgl", ".bin": "utia"}
"""The format that a file's name tells."""


def read_spec(spec: str) -> Material:
    """The material of `KIND:FILE[,angles=2|3]`.

    Raises
    ------
    InputError
        If the SPEC is malformed, or the file is not what its kind says.
    """
    found = read_measured(spec)
    return found.material(spec)


def read_measured(spec: str) -> Measured | Bivariate:
    """What `KIND:FILE[,angles=2|3]` names: in three angles, or with `angles=2` in two.

    Raises
    ------
    InputError
        As `read_spec`.
    """
    kind, _, rest = spec.partition(":")
    match = re.fullmatch(r"(.*?)(?:,\s*angles=(\w*))?", rest, re.DOTALL)
    assert match is not None  # the pattern takes any text
    path, angles = match.group(1), match.group(2)
    if kind not in MEASURED or not path:
        ending = next((e for e, k in EXTENSIONS.items() if k == kind), "")
        raise InputError(f"brdf {spec}: expected {kind}:FILE{ending}[,angles=2]\nforms: {FORMS}")
    if angles not in (None, "2", "3"):
        raise InputError(f"brdf {spec}: angles expected 2 or 3, got {angles}")
    found = read(path, kind)
    reduced = found.bivariate()
    share, _ = reduction_error(found, reduced)
    percent = f"{100 * share:.2g} % in the cosine-weighted norm"
    if angles == "2":
        return replace(reduced, notes=(*reduced.notes, f"{path}: two angles change it by {percent}"))
    return replace(
        found,
        notes=(*found.notes, f"{path}: two angles would change it by {percent}; angles=2 makes it editable"),
    )


def read(path: str | os.PathLike[str], kind: str | None = None) -> Measured:
    """A measured file in three angles; the kind is told by the name's ending where it is not given.

    Raises
    ------
    InputError
        If the ending is unknown, or the file is not what its kind says.
    """
    name = os.fspath(path)
    if kind is None:
        kind = EXTENSIONS.get(os.path.splitext(name)[1].lower())
    if kind == "merl":
        values, valid = read_merl(path)
        measured = merl_layout(values, valid, name=name)
        negative = int((~valid).sum())
        if negative:
            seen = int((measured.above & ~valid).sum())
            note = (
                f"{name}: {negative} of {valid.size} samples are negative, {seen} of them above the horizon; "
                "they are left out"
            )
            measured = replace(measured, notes=(note, *measured.notes))
        return measured
    if kind == "rgl":
        f = Adaptive(to_rgb(read_rgl(path), name))
        apart = 100 * reciprocity_error(f, least=LEAST_COSINE)
        note = f"{name}: f(i, o) and f(o, i) differ by {apart:.2g} % in the cosine-weighted norm; their mean is taken"
        return Measured.sample(f, least=LEAST_COSINE, name=name, notes=(note,))
    if kind == "utia":
        turned = Turned(read_utia(path), name)
        lost = f"{100 * turned.loss:.2g} % RMSE"
        notes = [
            f"{name}: is anisotropic; its mean over the turn about the normal, which is taken, differs by {lost}"
        ]
        if turned.negative:
            notes.append(f"{name}: {turned.negative} of {288 * 288} samples are negative; they are left out")
        return Measured.sample(turned, least=MEASURED_TO, name=name, notes=tuple(notes))
    check_source(path, tuple(EXTENSIONS), "a measured BRDF")
    raise InputError(f"{name}: expected a measured BRDF that ends in {', '.join(EXTENSIONS)}")
