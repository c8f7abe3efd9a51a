"""The viewer's table editor without a browser: recipes, looks, what a page may ask for, pictures, what is saved."""

from __future__ import annotations

import json
import math
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from prtcl.apps.view import saving
from prtcl.apps.view.look import PRESETS, History, Look
from prtcl.apps.view.recipe import RANGES, Recipe
from prtcl.apps.view.state import Eye, State
from prtcl.apps.view.table_panel import NOTHING, TablePanel, energy_line
from prtcl.apps.view.table_picture import lobe, picture, tone
from prtcl.errors import InputError
from prtcl.factors.bivariate import Bivariate
from prtcl.factors.material import Material
from prtcl.factors.table import Table

PLASTIC = PRESETS["red plastic"]
EYE = Eye((1.0, 2.0, 3.0), (0.0, 0.5, 0.0), (0.0, 1.0, 0.0), 0.6, (800, 500))


class Gui:
    """Stands in for viser's: handles that hold what they were given."""

    def __getattr__(self, name: str) -> Any:
        def add(label: Any, *given: Any, **options: Any) -> Any:
            position = {"add_slider": 3, "add_multi_slider": 3, "add_rgb": 0, "add_checkbox": 0}
            value = given[position[name]] if name in position else None
            value = given[0][0] if name == "add_dropdown" else value
            handle = SimpleNamespace(
                label=label, value=value, disabled=False, image=label, content=label, **options
            )
            return _Folder(label, **options) if name == "add_folder" else handle

        return add


class _Folder(SimpleNamespace):
    def __init__(self, label: str, **options: Any) -> None:
        super().__init__(label=label, **options)

    def __enter__(self) -> None:
        pass

    def __exit__(self, *error: object) -> None:
        pass


def values(recipe: Recipe) -> np.ndarray:
    return recipe.table.bivariate.values


# --- recipes ------------------------------------------------------------------------------------------------


def test_a_recipe_is_the_chain_of_its_edits() -> None:
    gold = PRESETS["gold"].material
    recipe = Recipe(
        PLASTIC.material, gold, 0.25, sharpen=1.0, balance=0.2, fresnel=1.5, theta_h=(2.0, 6.0),
        theta_d=(10.0, 60.0), paint=1.0, tint=(1.0, 0.5, 0.25), strength=0.5,
    )  # fmt: skip
    chain = Table.of(PLASTIC.material).blended(gold, 0.25).sharpened(2.0).balanced(0.2).with_fresnel(1.5)
    chain = chain.painted((2.0, 6.0), (10.0, 60.0), factor=2.0).tinted(1.0, 0.5, 0.25).scaled(0.5)
    np.testing.assert_array_equal(values(recipe), chain.bivariate.values)
    np.testing.assert_array_equal(
        values(Recipe(PLASTIC.material)), Table.of(PLASTIC.material).bivariate.values
    )
    bright = replace(recipe, strength=3.0, fresnel=3.0, paint=5.0)
    assert bright.table.energy > 1.0
    assert replace(bright, conserve=True).table.energy == pytest.approx(1.0, rel=1e-9)


def test_the_same_recipe_is_the_same_material() -> None:
    """So that a session finds its cuts again, also after undo."""
    first, again = (Recipe(PLASTIC.material, sharpen=0.5) for _ in range(2))
    assert first == again and first.material is again.material
    assert first.material.like is PLASTIC.material and first.material.table is not None
    assert replace(first, sharpen=0.6).material is not first.material


@pytest.mark.parametrize("name", RANGES)
def test_every_number_changes_the_table_and_is_kept_in_range(name: str) -> None:
    base = Recipe(PLASTIC.material, PRESETS["gold"].material)
    for end in RANGES[name]:
        if getattr(base, name) != end:
            changed = replace(base, **{name: end})  # type: ignore[arg-type]
            assert (values(changed).shape != values(base).shape) or (values(changed) != values(base)).any()
        assert np.isfinite(replace(base, **{name: end}).table.energy)  # type: ignore[arg-type]
    low, high = RANGES[name]
    for wild in (low - 1e9, high + 1e9):
        assert low <= getattr(replace(base, **{name: wild}).cleaned(), name) <= high  # type: ignore[arg-type]
    for none in (math.nan, "a", None):
        with pytest.raises(InputError, match="table: expected a number"):
            replace(base, **{name: none}).cleaned()  # type: ignore[arg-type]


def test_a_region_the_wrong_way_round_is_turned() -> None:
    assert Recipe(PLASTIC.material, theta_h=(50.0, -3.0)).cleaned().theta_h == (0.0, 50.0)


# --- looks --------------------------------------------------------------------------------------------------


def test_any_look_becomes_a_table_and_finds_its_edits_again() -> None:
    look = PLASTIC.tabulated()
    assert look.kind == "table" and look.recipe == Recipe(PLASTIC.material) and look.cleaned() == look
    assert look.tabulated() is look
    edited = replace(look, recipe=replace(look.recipe, sharpen=1.0))
    back = replace(edited, kind="dielectric")
    assert back.material is PLASTIC.material, "the sliders' material is still there"
    assert back.tabulated() == edited
    assert replace(back, alpha=0.5).tabulated().recipe == Recipe(replace(back, alpha=0.5).material)
    assert Look("table").cleaned().kind == "lambert", "nothing to edit"


def test_a_table_that_was_given_opens_as_one(tmp_path: Path) -> None:
    Table.of("ggx:alpha=0.3,f0=0.9").save(tmp_path / "t.npz")
    given = Material.parse(f"table:{tmp_path / 't.npz'}")
    look = Look.of(given)
    assert look.kind == "table" and look.recipe == Recipe(given) and look.given is given
    np.testing.assert_array_equal(look.material.table["values"], given.table["values"])  # type: ignore[index]


def test_undo_goes_back_through_edits() -> None:
    history, look = History(), PLASTIC.tabulated()
    looks = [(replace(look, recipe=replace(look.recipe, sharpen=s)),) for s in (0.0, 0.5, 1.0)]
    history.record(looks[0], "sharpen", 0.0)
    history.record(looks[1], "tint", 5.0)
    assert history.undo(looks[2]) == looks[1] and history.undo(looks[1]) == looks[0]
    assert history.redo(looks[0])[0].material is looks[1][0].material


# --- the panel ----------------------------------------------------------------------------------------------


def test_every_control_changes_its_number_and_shows_it_again() -> None:
    panel, look = TablePanel(Gui()), PLASTIC.tabulated()
    panel.show(PLASTIC)
    assert not panel.folder.visible
    panel.show(look)
    assert panel.folder.visible and panel._sliders["blend"].disabled
    wanted = {"sharpen": 1.0, "balance": 0.5, "fresnel": 2.0, "strength": 0.5, "blend": 0.25, "paint": -2.0,
              "theta_h": (1.0, 3.0), "theta_d": (5.0, 60.0)}  # fmt: skip
    recipe = look.recipe
    assert recipe is not None
    for name, value in wanted.items():
        control = {**panel._sliders, **panel._ends}[name]
        control.value = value
        recipe = panel.changed(recipe, control)
        assert getattr(recipe, name) == value
    panel.tint.value, panel.other.value, panel.conserve.value = (255, 0, 128), "gold", True
    for control in (panel.tint, panel.other, panel.conserve):
        recipe = panel.changed(recipe, control)
    assert recipe.other is PRESETS["gold"].material and recipe.conserve and recipe.tint[:2] == (1.0, 0.0)
    assert len(panel.controls) == len(fields(Recipe)) - 1, "one for each but the base"
    fresh = TablePanel(Gui())
    fresh.show(replace(look, recipe=recipe))
    for one, other in zip(panel.controls, fresh.controls, strict=True):
        assert one.value == other.value, one.label
    touched = fresh._sliders["sharpen"]
    touched.value = 0.123
    fresh.show(replace(look, recipe=recipe), touched)
    assert touched.value == 0.123, "not under the hand"
    panel.other.value = NOTHING
    assert panel.changed(recipe, panel.other).other is None
    assert panel.changed(recipe, panel.other).blend == 0.0


def test_a_mix_begins_with_half() -> None:
    panel = TablePanel(Gui())
    panel.other.value = "gold"
    assert panel.changed(Recipe(PLASTIC.material), panel.other).blend == 0.5
    panel.other.value = "../secret"
    assert panel.changed(Recipe(PLASTIC.material), panel.other).other is None


def test_picture_and_warning_follow_the_table_once_a_change() -> None:
    panel, look = TablePanel(Gui()), PLASTIC.tabulated()
    panel.draw(look)
    first = panel.image.image
    assert panel.warning.content.startswith("Reflects ")
    panel.draw(look)
    assert panel.image.image is first
    panel.draw(replace(look, recipe=replace(look.recipe, strength=3.0)))
    assert (panel.image.image != first).any() and panel.warning.content.startswith("**Too bright")
    panel.draw(PLASTIC)
    assert energy_line(1.0).startswith("Reflects 100 %")


# --- pictures -----------------------------------------------------------------------------------------------


def test_the_picture_has_the_highlight_at_the_left_and_grazing_above() -> None:
    h, d = np.linspace(0.0, np.pi / 2, 91), np.linspace(0.0, np.pi / 2, 91)
    made = np.zeros((91, 91, 3))
    made[h < np.radians(5), :, 0] = 10.0
    made[:, d > np.radians(70), 1] = 10.0
    own = Bivariate.make(made, h, d)
    shown = picture(own).astype(int)
    assert shown[200, 100, 0] > 200 > 60 > shown[200, 300, 0], "red to the left of 5 degrees, at √(5/90)"
    assert shown[50, 300, 1] > 200 > 60 > shown[200, 300, 1], "green above 70 degrees"
    framed = picture(own, ((20.0, 40.0), (20.0, 40.0))).astype(int)
    assert (framed[:350] != shown[:350]).any() and (framed[350:] == shown[350:]).all()
    assert np.isfinite(picture(Bivariate.make(np.zeros((1, 1)), [0.0], [0.0]))).all()


def test_white_lambert_is_half_of_the_most() -> None:
    assert tone(np.array([0.0, 1 / np.pi, 1e9])).tolist() == [0, 188, 255]


def test_lobes_peak_at_the_mirror_angle() -> None:
    own, out = Table.of("ggx:alpha=0.05,f0=0.9").bivariate, np.linspace(-89, 89, 357)
    for incidence in (0.0, 30.0, 60.0):
        assert abs(out[lobe(own, incidence, out).argmax()] - incidence) <= 2.0
    flat = Bivariate.make([[0.25]], [0.0], [0.0])
    np.testing.assert_array_equal(lobe(flat, 45.0, out), 0.25)


# --- saving -------------------------------------------------------------------------------------------------


def test_a_table_is_saved_beside_the_material(tmp_path: Path) -> None:
    look = replace(
        PLASTIC.tabulated(), recipe=Recipe(PLASTIC.material, PRESETS["gold"].material, 0.5, sharpen=0.5)
    )
    state = State(EYE, (Look(), look), "sky")
    text, npz = saving.save_material(tmp_path, state, ("1", "2 body"))
    assert (text.name, npz.name) == ("material-001.json", "material-001-part2.npz")
    saved = json.loads(text.read_text())["materials"]
    assert saved[0] == {"part": "1", "brdf": "lambert:albedo=0.5/0.5/0.5"}
    assert saved[1]["brdf"] == "table:material-001-part2.npz"
    assert saved[1]["edits"]["base"] == PLASTIC.spec and saved[1]["edits"]["sharpen"] == 0.5
    back = Material.parse(f"table:{npz}")
    np.testing.assert_array_equal(back.table["values"], values(look.recipe))  # type: ignore[index, arg-type]
    again = saving.save_material(tmp_path, state, ("1", "2 body"))
    assert [path.name for path in again] == ["material-002.json", "material-002-part2.npz"]
