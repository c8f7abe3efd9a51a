"""A share of bench/fuzz.py's damaged files, what it found, and that it finds: crashes, hangs, broken promises."""

from __future__ import annotations

import importlib
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from prtcl.errors import InputError
from prtcl.files.tensor_file import read_tensors
from prtcl.scene.bake import Bake
from prtcl.scene.mesh import Mesh

INPUTS = {
    "exr": 400, "hdr": 400, "merl": 400, "merl whole": 2, "utia": 60, "rgl": 700, "table": 200, "table arrays": 300,
    "bake .npz": 200, "bake .npz arrays": 400, "bake .zarr": 100,
}  # fmt: skip
SEED = 1000
"""Not that of the whole run, whose first inputs these would be."""


@pytest.fixture
def fuzz() -> Iterator[SimpleNamespace]:
    """bench/fuzz.py and what it imports, which leave no trace."""
    before = set(sys.modules)
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))
    try:
        names = ("fuzz", "fuzz_readers", "mutations")
        yield SimpleNamespace(**{name: importlib.import_module(name) for name in names})
    finally:
        sys.path.pop(0)
        for name in ("fuzz", "fuzz_readers", "mutations", "scenes"):
            if name not in before:
                sys.modules.pop(name, None)


def need(reader: str) -> None:
    """Skip a reader whose optional package is not there."""
    package = {"hdr": "OpenImageIO", "bake .zarr": "zarr"}.get(reader)
    if package is not None:
        pytest.importorskip(package, reason=f"this reader takes {package}")


def test_every_reader_has_its_share_here(fuzz: SimpleNamespace) -> None:
    assert set(INPUTS) == set(fuzz.fuzz_readers.READERS) and sum(INPUTS.values()) > 3000


@pytest.mark.parametrize("reader", INPUTS)
def test_damaged_files_give_a_value_or_a_refusal(fuzz: SimpleNamespace, tmp_path: Path, reader: str) -> None:
    need(reader)
    found = fuzz.fuzz.work(reader, SEED, 0, INPUTS[reader], tmp_path)
    assert not found["findings"], found["findings"][0]["what"]
    counts = found["counts"]
    assert counts["value"] + counts["refused"] == INPUTS[reader]
    if INPUTS[reader] > 100 and reader != "bake .zarr":
        assert counts["refused"] > INPUTS[reader] / 2  # most mutations are damage …
        # … and some go through to the end; but of MERL's header no file here has the length.
        assert (counts["value"] > 0) == (reader != "merl")


def test_inputs_are_the_same_in_every_run(fuzz: SimpleNamespace, tmp_path: Path) -> None:
    reader = fuzz.fuzz_readers.READERS["rgl"]
    bases = reader.make(tmp_path)
    runs: list[list[bytes]] = [
        [
            reader.spoil(tmp_path, bases, fuzz.fuzz.rng_of(1, "rgl", number)).read_bytes()
            for number in range(20)
        ]
        for _ in range(2)
    ]
    assert runs[0] == runs[1] and len(set(runs[0])) > 15


@pytest.mark.parametrize("kind", range(11))
def test_mutations_change_bytes_or_length(fuzz: SimpleNamespace, kind: int) -> None:
    mutation, rng = fuzz.mutations.KINDS[kind], np.random.default_rng(kind)
    data, other, changed = bytes(range(100, 200)), bytes(range(200, 256)), 0
    for _ in range(200):
        out = bytearray(data)
        mutation(out, int(rng.integers(100)), rng, other)
        changed += bytes(out) != data
    assert changed > 180 and len(fuzz.mutations.KINDS) == 11


WORKER = """
import json, os, sys, time
first, stop, folder, progress, out = int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:]
for number in range(first, stop):
    open(progress, "w").write(str(number))
    if number == 3: os.abort()
    if number == 7: time.sleep(60)
json.dump({"counts": {"value": stop - first}, "findings": [], "warning": ""}, open(out, "w"))
"""


def test_crashes_and_hangs_are_found_and_the_rest_is_read(fuzz: SimpleNamespace) -> None:
    found = fuzz.fuzz.supervise("exr", 1, 0, 10, limit=2.0, command=[sys.executable, "-c", WORKER])
    assert [(finding["number"], finding["kind"]) for finding in found["findings"]] == [
        (3, "crash"),
        (7, "hang"),
    ]
    assert found["counts"] == {"value": 8}


@pytest.mark.parametrize(
    ("raised", "kind"),
    [(ValueError("x"), "exception"), (AssertionError("NaN"), "answer"), (InputError("no name"), "message")],
)
def test_what_is_no_refusal_by_name_is_a_finding(
    fuzz: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, raised: Exception, kind: str
) -> None:
    def read(path: Path) -> None:
        if path.name.startswith("input"):
            raise raised

    module: ModuleType = fuzz.fuzz_readers
    good = module.READERS["rgl"]
    monkeypatch.setitem(module.READERS, "rgl", module.Reader(1, good.make, good.spoil, read))
    found = fuzz.fuzz.work("rgl", 1, 4, 6, tmp_path)
    assert [(finding["number"], finding["kind"]) for finding in found["findings"]] == [(4, kind), (5, kind)]


def test_parts_make_the_whole(fuzz: SimpleNamespace) -> None:
    part: dict[str, Any] = {
        "inputs": 3,
        "seconds": 1.0,
        "seed": 1,
        "readers": {"exr": {"value": 3}},
        "findings": [],
    }
    whole = fuzz.fuzz.merge([part, {**part, "findings": [{"number": 1}]}])
    assert whole["inputs"] == 6 and whole["readers"]["exr"]["value"] == 6 and len(whole["findings"]) == 1


# --- what it found -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"rays": np.array(b"\x93")}, "rays expected i of shape"),
        ({"format": np.zeros((3, 3))}, "a bake of format unknown"),
        ({"format": np.array("one")}, "a bake of format unknown"),
        (
            {"name": np.array(0x7FFFFFFF, "<u4").reshape(1).view("<U1")[0:1].reshape(())},
            "name expected a text",
        ),
        ({"name": np.array("\ud800")}, "name expected a text"),
        ({"name": np.zeros(2)}, "name expected a text"),
    ],
)
def test_bakes_that_broke_the_reader(tmp_path: Path, change: dict[str, NDArray[Any]], word: str) -> None:
    path = tmp_path / "a.npz"
    Bake.trace(Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), rays=1).save(path)
    with np.load(path) as file:
        data = {**file, **change}
    np.savez(path, **data)
    with pytest.raises(InputError, match=word) as caught:
        Bake.load(path)
    assert len(str(caught.value).splitlines()) == 1


def test_a_tensor_of_no_elements_may_not_be_huge(tmp_path: Path) -> None:
    """Its data take no bytes, and NumPy makes it; the first conversion of it failed."""
    path, field = tmp_path / "a.bsdf", struct.pack("<H3sHBQ2Q", 3, b"ndf", 2, 10, 18, 0, 1 << 60)
    path.write_bytes(b"tensor_file\0\1\0" + struct.pack("<I", 1) + field)
    with pytest.raises(InputError, match="ends beyond the file"):
        read_tensors(path, ["ndf"], (".bsdf",), "a BRDF")
