"""Tables in a session: edits, undo, and whose cut an edit wears, at what error."""

from __future__ import annotations

import numpy as np
import pytest
from cases import DEMO_CAMERA

from prtcl.compute.device import Device
from prtcl.errors import InputError
from prtcl.factors.environment import Environment
from prtcl.factors.table import Table
from prtcl.scene.mesh import Mesh
from prtcl.scene.session import Session

GLAZE = "ggx:alpha=0.2,f0=0.04,kd=0.1/0.4/0.2"


@pytest.fixture
def own(mesh: Mesh, sky: Environment, device: Device) -> Session:
    return Session(mesh, sky, GLAZE, DEMO_CAMERA, device=device, levels=4)


def rmse(a, b) -> float:  # type: ignore[no-untyped-def]
    return float(np.sqrt(((a.astype(np.float64) - b) ** 2).mean()) / b.mean())


def test_an_edit_is_seen_and_undo_finds_picture_and_cut_again(own: Session) -> None:
    analytic = own.view().image
    own.edit(lambda table: table.scaled(1.0))
    first = own.view().image
    assert rmse(first, analytic) < 0.02, "the table is the material"
    table = own.edit(lambda table: table.tinted(0.0, 1.0, 1.0).sharpened(3.0))
    second = own.view().image
    assert second[..., 0].max() == 0.0 < second[..., 1].max()
    assert own.material.table is not None
    np.testing.assert_array_equal(own.material.table["values"], table.bivariate.values)
    worn, tries, cuts = own.material, len(own._relit._tried), len(own._relit._cuts)
    for step, expected in ((own.undo, first), (own.undo, analytic), (own.redo, first), (own.redo, second)):
        assert step()
        assert (own.view().image == expected).all(), "bit for bit"
    assert own.material is worn
    assert (len(own._relit._tried), len(own._relit._cuts)) == (tries, cuts), "nothing was fitted anew"


def test_tables_saved_and_assigned_undo_as_well(own: Session, tmp_path) -> None:  # type: ignore[no-untyped-def]
    Table.of(GLAZE).sharpened(0.5).save(tmp_path / "soft.npz")
    own.material = Table.load(tmp_path / "soft.npz").material()
    soft = own.view().image
    own.material = f"table:{tmp_path / 'soft.npz'}"
    assert (own.view().image == soft).all()
    own.snapshot("soft")
    own.edit(lambda table: table.balanced(0.5))
    assert (own.view().image != soft).any()
    own.restore("soft")
    assert (own.view().image == soft).all()


def test_a_picture_does_not_depend_on_the_edits_before_it(own: Session, mesh: Mesh, sky: Environment) -> None:
    def wanted(table: Table) -> Table:
        return table.sharpened(2.0)

    for factor in (0.5, 4.0, 1.3):
        own.edit(lambda table, factor=factor: table.sharpened(factor))
        own.view(draft=True)
        own.undo()
    own.edit(wanted)
    own.view(draft=True)
    fresh = Session(mesh, sky, GLAZE, DEMO_CAMERA, device=own.device, levels=4)
    fresh.edit(wanted)
    assert (own.view().image == fresh.view().image).all()


@pytest.mark.parametrize("strong", [False, True])
def test_a_draft_wears_another_cut_and_says_what_it_costs(own: Session, strong: bool) -> None:
    """The error told is that of the table shown; one that would be too large is not taken at rest."""
    own.error = 0.01
    own.view()
    cuts = len(own._relit._cuts)
    own.edit(
        (lambda t: t.blended("lambert:albedo=0.01", 0.5).sharpened(4.0))
        if strong
        else (lambda t: t.tinted(1, 0.9, 1))
    )
    draft = own.view(draft=True)
    if not strong:
        assert len(own._relit._cuts) == cuts, "no fit while the hand drags"
    rest = own.view()
    told = [render.report["expected_error"] for render in (draft, rest)]
    assert told[0] <= 4 * own.error and told[1] <= 1.5 * own.error
    own.error = 0.0
    exact = own.view().image
    for render, error in zip((draft, rest), told, strict=True):
        # Measured at a sample of the mesh's points, from all around: of one view about so much.
        found = rmse(render.image[..., :3], exact[..., :3])
        print(f"told {error:.4f}, found {found:.4f}")
        assert found < 3 * error + 1e-4


def test_parts_are_edited_alone_or_all_together(mesh: Mesh, sky: Environment, device: Device) -> None:
    half = (np.arange(len(mesh.vertices)) % 2).astype(int)
    own = Session(mesh, sky, [GLAZE, GLAZE], DEMO_CAMERA, device=device, levels=3, assignment=half)
    before = own.materials
    own.edit(lambda table: table.scaled(0.5), part=1)
    assert own.materials[0] is before[0] and own.materials[1].table is not None
    assert own.materials[1].like is before[1]
    own.edit(lambda table: table.scaled(0.5))
    assert own.materials[1].like is before[1], "over any number of edits"
    assert own.undo() and own.undo() and own.materials == before
    with pytest.raises(InputError, match="part: expected 0 to 1, got 2"):
        own.edit(lambda table: table, part=2)
    with pytest.raises(InputError, match="factor: expected"):
        own.edit(lambda table: table.scaled(-1.0))
    assert own.materials == before and not own.undo()
    own.material = GLAZE
    own.edit(lambda table: table.scaled(0.5))
    assert own.materials[0] is own.materials[1], "what wore the same still does"


def test_cuts_of_many_edits_do_not_pile_up(own: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("prtcl.transport.edit.CUTS", 3)
    own.view()
    for step in range(6):
        own.edit(lambda table, step=step: table.sharpened(1.0 + 0.1 * step))
        assert np.isfinite(own.view().image).all()
    assert len(own._relit._cuts) <= 3 and len(own._relit._tried) <= 3


def test_an_edit_that_returns_no_table_is_refused(own: Session) -> None:
    before = own.materials
    with pytest.raises(InputError, match="edit: expected the function to return a table, got NoneType"):
        own.edit(lambda table: None)  # type: ignore[arg-type, return-value]
    assert own.materials == before
