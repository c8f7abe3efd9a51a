"""The floors: nothing imports from a floor above its own."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "prtcl"
FLOORS: list[tuple[str, ...]] = [
    ("errors", "_version", "quadtree", "bounds"),
    ("compute", "files"),
    ("wavelet",),
    ("factors",),
    ("transport",),
    ("scene",),
    ("stages", "apps", "__main__"),
]
FLOOR = {name: height for height, names in enumerate(FLOORS) for name in names}
MODULES = sorted(PACKAGE.rglob("*.py"))


ORACLES = ("prtcl.apps.bench.oracle", "prtcl.apps.stress.oracle", "prtcl.transport.truth")


def imported(source: str, package: str) -> set[str]:
    """Dotted names of what a source imports from prtcl, wherever in the file."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*parents, *([node.module] if node.module else [])])
            found.update(f"{base}.{alias.name}" for alias in node.names)
    return {name for name in found if name.split(".")[0] == "prtcl"}


def typing_only(source: str) -> set[str]:
    """What a source imports from prtcl for type checkers alone."""
    blocks = [
        node
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
    ]
    return set().union(*(imported(ast.unparse(ast.Module(block.body, [])), "prtcl") for block in blocks))


def violations(source: str, module: str) -> list[str]:
    """What `module` (dotted, such as prtcl.compute.device) imports from above, or besides what it may."""
    parts = module.split(".")
    package = ".".join(parts[:-1])
    bad = []
    for name in sorted(imported(source, package)):
        target = name.split(".")[1] if "." in name else ""
        if target == "__version__":
            target = "_version"
        if parts[1:] == ["reference"]:
            allowed = target == "quadtree"
        elif parts[1:] == ["__init__"]:
            # It offers names of every floor, but only when they are asked for.
            allowed = target == "_version" or name in typing_only(source)
        elif target == "reference":
            # The oracle stands apart; only what holds results against it while it runs may know it.
            allowed = module in ORACLES
        else:
            allowed = target in FLOOR and FLOOR[target] <= FLOOR[parts[1]]
        if not allowed:
            bad.append(f"{module} imports {name}")
    return bad


def dotted(path: Path) -> str:
    return ".".join(["prtcl", *path.relative_to(PACKAGE).with_suffix("").parts])


@pytest.mark.parametrize("path", MODULES, ids=dotted)
def test_nothing_imports_from_above(path: Path) -> None:
    assert violations(path.read_text(encoding="utf-8"), dotted(path)) == []


def test_every_module_has_a_floor() -> None:
    names = {dotted(path).split(".")[1] for path in MODULES}
    assert names - {"__init__", "reference"} <= set(FLOOR)
    assert {"compute", "wavelet", "factors", "transport", "reference"} <= names


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("prtcl.compute.device", "from prtcl.wavelet import haar"),
        ("prtcl.compute.device", "def f():\n    import prtcl.apps.cli"),
        ("prtcl.wavelet.haar", "from prtcl import transport"),
        ("prtcl.factors.slices", "from ..transport import shade"),
        ("prtcl.factors.slices", "from .. import scene"),
        ("prtcl.quadtree", "from prtcl.compute import source"),
        ("prtcl.reference", "from prtcl.errors import InputError"),
        ("prtcl.transport.shade", "from prtcl import reference"),
        ("prtcl.apps.bench.light", "from prtcl import reference"),
    ],
)
def test_the_check_finds_what_it_should(module: str, source: str) -> None:
    assert len(violations(source, module)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("prtcl.factors.slices", "from ..compute import device\nfrom . import hemisphere\nimport numpy"),
        ("prtcl.apps.cli", "from prtcl import __version__\nfrom prtcl.scene.scene import Scene"),
        ("prtcl.reference", "from prtcl import quadtree"),
    ],
)
def test_the_check_allows_what_it_should(module: str, source: str) -> None:
    assert violations(source, module) == []
