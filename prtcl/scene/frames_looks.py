"""What a batch's mesh is seen in: one material, one for each part, or the mesh's own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from prtcl.errors import InputError
from prtcl.factors.material import Material
from prtcl.scene.mesh import Mesh
from prtcl.scene.scene import own_materials
from prtcl.scene.tint import Tints, colour_notes
from prtcl.transport.settings import Settings, settle

Assignment = npt.NDArray[np.int32]


class Looks:
    """Materials of all looks in one row, and which of them each part of the mesh wears in each.

    Parameters
    ----------
    given : for each look a SPEC or `Material`, a list of one for each part of the mesh, or None for the mesh's own
    alone : whether points share no pixel with others (`prtcl.transport.settings.choose`): vertices
    baked : levels of a bake's visibility; None where visibility is traced
    **settings : fixed by hand

    Attributes
    ----------
    worn : for each look its materials, one or one a part
    materials, settings : of all looks, one after another, and what is left of the tinted ones without their tint
    full, left : for each look (parts,) int32 indices of `materials`; −1 in `left` where nothing is left
    tinted : for each look (parts,) whether the mesh's colour multiplies it
    notes : for people
    """

    def __init__(
        self, given: Sequence[str | Material | Sequence[str | Material] | None], mesh: Mesh, *,
        alone: bool = False, baked: int | None = None, **settings: float | str | None,
    ) -> None:  # fmt: skip
        if not given:
            raise InputError("materials: expected one or more, got none")
        parts = len(mesh.materials)
        self.worn: list[list[Material]] = []
        self.materials: list[Material] = []
        self.settings: list[Settings] = []
        self.full: list[Assignment] = []
        self.left: list[Assignment] = []
        self.tinted: list[npt.NDArray[np.bool_]] = []
        self.notes: list[str] = []
        for look in given:
            if isinstance(look, str | Material):
                own, which = [Material.parse(look)], np.zeros(parts, dtype=np.int32)
            else:
                own = own_materials(mesh) if look is None else [Material.parse(m) for m in look]
                which = np.arange(parts, dtype=np.int32)
                if len(own) != parts:
                    raise InputError(
                        f"materials: expected one, or {parts} for the mesh's parts, got {len(own)}"
                    )
            tints = Tints(own, mesh)
            first = len(self.materials)
            self.worn.append(own)
            self.materials += tints.materials
            chosen = [settle(material, alone, baked, settings)[0] for material in own]
            self.settings += [chosen[parent] for parent in tints.parent]
            self.full.append(first + which)
            left = tints.left[which]
            self.left.append(np.where(left >= 0, first + left, -1).astype(np.int32))
            self.tinted.append(tints.tinted[which])
            self.notes += [note for m in own for note in m.notes] + colour_notes(own, mesh)
        self.notes = list(dict.fromkeys(self.notes))
