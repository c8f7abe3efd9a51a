"""Colours of a mesh's own: vertex colours and textures of each format, looked up, interpolated and baked."""

from __future__ import annotations

import base64
import io
import json
import re
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from test_scene_mesh import CUBE, CUBE_FACES, OUTWARD, Gltf, obj_text, save, simple_gltf

from prtcl.errors import InputError
from prtcl.files.image import srgb
from prtcl.scene.bake import Bake
from prtcl.scene.mesh import Mesh, PartMaterial, Texture, read_mesh
from prtcl.scene.mesh_gltf_nodes import Resources
from prtcl.scene.texture import WRAPS, decode_image, linear

# Linear values of sRGB bytes, from the definition: (51/255 = 0.2 -> ((0.2 + 0.055) / 1.055)^2.4, and so on.
BYTES = {0: 0.0, 10: 10 / 255 / 12.92, 51: 0.03310476657, 128: 0.21586050011, 255: 1.0}
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]])
# Four colours that differ in every channel, and texture coordinates in which u and v are no mirror of each other.
CORNERS = np.array([[255, 0, 51], [0, 128, 255], [51, 255, 0], [128, 51, 10]], dtype=np.uint8)
UV = np.array([[0.0, 0.25], [0.5, 0.25], [0.5, 1.0], [0.0, 1.0]])
DOWN = np.array([[0.0, 0.75], [0.5, 0.75], [0.5, 0.0], [0.0, 0.0]])  # UV with v from the top
IMAGE = np.random.default_rng(5).integers(0, 256, (3, 5, 3), dtype=np.uint8)


def decoded(values: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Linear values of sRGB bytes, by the table above."""
    return np.vectorize(BYTES.__getitem__)(values)


def png(image: NDArray[Any] = IMAGE) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, format="PNG")
    return file.getvalue()


def ply_text(columns: dict[str, tuple[str, Any]], comment: str = "", faces: str = "") -> bytes:
    """An ASCII PLY of the square, with more columns of its vertices: name to type and values."""
    head = f"ply\nformat ascii 1.0\n{comment}element vertex 4\n"
    head += "".join(f"property double {name}\n" for name in "xyz")
    head += "".join(f"property {kind} {name}\n" for name, (kind, _) in columns.items())
    head += f"element face 2\nproperty list uchar int vertex_indices\n{faces}end_header\n"
    rows = np.column_stack([SQUARE, *(values for _, values in columns.values())])
    lines = [" ".join(f"{value:.9g}" for value in row) for row in rows]
    more = " 1 2 3" if "uchar red" in faces else " 6 0 0 1 0 1 1" if "texcoord" in faces else ""
    return (head + "\n".join(lines) + f"\n3 0 1 2{more}\n3 0 2 3{more}\n").encode()


def ply_binary(order: str) -> bytes:
    """A binary PLY of the square with colours as bytes and alpha as float, which trimesh would join to float."""
    head = f"ply\nformat binary_{order}_endian 1.0\nelement vertex 4\n"
    head += "".join(f"property float {name}\n" for name in "xyz")
    head += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    head += "property float alpha\nproperty float s\nproperty float t\n"
    head += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    mark = "<" if order == "little" else ">"
    body = b"".join(
        struct.pack(mark + "3f3B3f", *p, *c, 0.5, *uv)
        for p, c, uv in zip(SQUARE.tolist(), CORNERS.tolist(), UV.tolist(), strict=True)
    )
    return head.encode() + body + b"".join(struct.pack(mark + "B3i", 3, *f) for f in SQUARE_FACES.tolist())


def colour_columns(kind: str, values: Any, names: tuple[str, str, str] = ("red", "green", "blue")) -> Any:
    return {name: (kind, np.asarray(values)[:, axis]) for axis, name in enumerate(names)}


def uv_columns(names: tuple[str, str]) -> Any:
    return {name: ("float", UV[:, axis]) for axis, name in enumerate(names)}


# --- PLY -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "names", [("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b")]
)
def test_ply_bytes_are_srgb(tmp_path: Path, names: tuple[str, str, str]) -> None:
    mesh = read_mesh(save(tmp_path / "a.ply", ply_text(colour_columns("uchar", CORNERS, names))))
    assert mesh.colours is not None and mesh.colours.dtype == np.float32
    np.testing.assert_allclose(mesh.colours, decoded(CORNERS), rtol=1e-6)
    np.testing.assert_array_equal(mesh.vertices, SQUARE)
    assert mesh.notes == () and mesh.uv is None and mesh.materials == (None,)


def test_ply_floats_are_linear_and_shorts_are_srgb(tmp_path: Path) -> None:
    stored = CORNERS / 255.0
    mesh = read_mesh(save(tmp_path / "a.ply", ply_text(colour_columns("float", stored))))
    np.testing.assert_allclose(mesh.colours, stored, rtol=1e-6)
    mesh = read_mesh(save(tmp_path / "a.ply", ply_text(colour_columns("ushort", CORNERS * 257.0))))
    np.testing.assert_allclose(mesh.colours, decoded(CORNERS), rtol=1e-6)


@pytest.mark.parametrize("order", ["little", "big"])
def test_binary_ply(tmp_path: Path, order: str) -> None:
    mesh = read_mesh(save(tmp_path / "a.ply", ply_binary(order)))
    np.testing.assert_allclose(mesh.colours, decoded(CORNERS), rtol=1e-6)
    np.testing.assert_array_equal(mesh.uv, DOWN)
    np.testing.assert_array_equal(mesh.vertices, SQUARE)
    np.testing.assert_array_equal(mesh.faces, SQUARE_FACES)


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_ply_texture(tmp_path: Path, names: tuple[str, str]) -> None:
    save(tmp_path / "my image.png", png())
    data = ply_text(uv_columns(names), "comment TextureFile my image.png\n")
    mesh = read_mesh(save(tmp_path / "a.ply", data))
    assert mesh.uv is not None and mesh.uv.dtype == np.float32 and mesh.notes == () and mesh.colours is None
    np.testing.assert_array_equal(mesh.uv, DOWN)
    (part,) = mesh.materials
    assert part is not None and part.texture is not None
    assert part == PartMaterial("", (1.0, 1.0, 1.0), 0.0, 1.0, part.texture)
    np.testing.assert_array_equal(part.texture.image, IMAGE)
    assert part.texture.wrap == ("repeat", "repeat") and mesh.coloured.tolist() == [True]


def test_ply_colours_and_coordinates_of_faces_are_left_out_with_a_note(tmp_path: Path) -> None:
    of_faces = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    mesh = read_mesh(save(tmp_path / "a.ply", ply_text({}, faces=of_faces)))
    assert mesh.colours is None and len(mesh.notes) == 1
    assert mesh.notes[0].startswith("has colours of faces, which are not read yet")
    listed = ply_text({}, "comment TextureFile a.png\n", "property list uchar float texcoord\n")
    mesh = read_mesh(save(tmp_path / "a.ply", listed))
    assert mesh.uv is None and mesh.materials == (None,)
    assert mesh.notes[0].startswith("has texture coordinates of faces, which are not read yet")
    assert "no texture coordinates" in mesh.notes[1]


# --- OBJ -----------------------------------------------------------------------------------------------------


def test_obj_colours_are_srgb_and_white_where_there_are_none(tmp_path: Path) -> None:
    lines = obj_text(SQUARE, SQUARE_FACES).splitlines()
    lines[1] += " 0.2 1 0"
    lines[3] += " 0 0.5019607843137255 1"
    mesh = read_mesh(save(tmp_path / "a.obj", "\n".join(lines)))
    expected = [[1, 1, 1], [BYTES[51], 1, 0], [1, 1, 1], [0, BYTES[128], 1]]
    np.testing.assert_allclose(mesh.colours, expected, rtol=1e-6)
    np.testing.assert_array_equal(mesh.vertices, SQUARE)
    assert mesh.notes == () and mesh.coloured.tolist() == [True]


def sides() -> tuple[list[str], NDArray[np.float64]]:
    """OBJ lines of a cube whose every side has its own corner of the image, and the (12, 3, 2) uv of its corners."""
    lines = obj_text(CUBE, CUBE_FACES).splitlines()[:8]
    uv = np.zeros((12, 3, 2))
    faces = []
    for face, corners in enumerate(CUBE_FACES):
        axes = [axis for axis in range(3) if np.ptp(CUBE[corners, axis]) > 0]
        uv[face] = (CUBE[corners][:, axes] + [face // 2, 0]) / [6, 1]
        lines += [f"vt {u:.9f} {v:.9f}" for u, v in uv[face]]
        faces.append("f " + " ".join(f"{v + 1}/{3 * face + c + 1}" for c, v in enumerate(corners)))
    return lines + faces, uv


def test_obj_seams_split_vertices_in_place(tmp_path: Path) -> None:
    save(tmp_path / "a.mtl", "newmtl m\nmap_Kd a.png\n")
    save(tmp_path / "a.png", png())
    lines, uv = sides()
    lines[:8] = [f"{line} {x} {y} {z}" for line, (x, y, z) in zip(lines[:8], CUBE * 0.2, strict=True)]
    mesh = read_mesh(save(tmp_path / "a.obj", "\n".join(["mtllib a.mtl", "usemtl m", *lines])))
    uv[..., 1] = 1 - uv[..., 1]
    assert mesh.uv is not None and mesh.colours is not None and mesh.notes == ()
    np.testing.assert_allclose(mesh.uv[mesh.faces], uv, atol=1e-6)
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], CUBE[CUBE_FACES])
    np.testing.assert_allclose(mesh.colours, mesh.vertices * BYTES[51], rtol=1e-6)
    # Each vertex once for each of its triangles (their vt lines are all separate), in the order of the file.
    assert len(mesh.vertices) == 36
    order = [int(np.flatnonzero((vertex == CUBE).all(axis=1))[0]) for vertex in mesh.vertices]
    assert order == sorted(order)
    (part,) = mesh.materials
    assert part is not None and part.base_color == (1.0, 1.0, 1.0) and part.texture is not None


def test_obj_seams_do_not_crease_smooth_normals(tmp_path: Path) -> None:
    lines, _ = sides()
    mesh = read_mesh(save(tmp_path / "a.obj", "\n".join(lines)))
    assert mesh.normals is None and len(mesh.vertices) == 36
    smooth = mesh.smooth()
    expected = (mesh.vertices - 0.5) * 2 / np.sqrt(3)
    np.testing.assert_allclose(smooth.normals, expected, atol=1e-6)
    assert smooth.uv is mesh.uv
    # Normals that are missing in the file are made across seams as well.
    zero = ["vn 0 0 0", *(re.sub(r"(\d+/\d+)", r"\1/1", line) for line in lines)]
    plain = Mesh.from_arrays(CUBE, CUBE_FACES, np.zeros((8, 3))).normals
    mesh = read_mesh(save(tmp_path / "c.obj", "\n".join(zero)))
    assert mesh.normals is not None and plain is not None and len(mesh.normals) == 36
    np.testing.assert_allclose(mesh.normals[mesh.faces], plain[CUBE_FACES], atol=1e-6)
    # What the file's own normals split stays split, whichever coordinates it has.
    hard = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvn 0 0 1\nvn -1 0 0\n"
    hard += "f 1/1/1 2/1/1 3/1/1\nf 1/1/2 4/1/2 3/1/2\nf 1/2/1 2/1/1 3/1/1\n"
    mesh = read_mesh(save(tmp_path / "b.obj", hard))
    np.testing.assert_array_equal(mesh.vertices[:3], np.zeros((3, 3)))
    np.testing.assert_array_equal(mesh.uv[:3], [[0, 1], [1, 1], [0, 1]])  # type: ignore[index]
    assert mesh.twins is not None and mesh.twins.tolist() == [0, 0, 2, 3, 4, 5, 6]
    smooth = mesh.smooth()
    np.testing.assert_allclose(smooth.normals[:3], [[0, 0, 1], [0, 0, 1], [-1, 0, 0]], atol=1e-6)  # type: ignore[index]


def test_obj_corners_without_coordinates(tmp_path: Path) -> None:
    """A missing, impossible or partly given index of texture coordinates is no reason to refuse the geometry."""
    save(tmp_path / "a.mtl", "newmtl m\nmap_Kd a.png\n")
    save(tmp_path / "a.png", png())
    head = "mtllib a.mtl\nusemtl m\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in SQUARE)
    mesh = read_mesh(save(tmp_path / "a.obj", head + "vt 0.25 0.5\nf 1/1 2/1 3/1\nf 1 3/0 4\n"))
    assert mesh.uv is not None and "1 triangles without texture coordinates" in mesh.notes[0]
    np.testing.assert_array_equal(mesh.uv[mesh.faces], [[[0.25, 0.5]] * 3, [[0, 0]] * 3])
    mesh = read_mesh(save(tmp_path / "a.obj", head + "vt 0.25 0.5\nf 1/1 2/1 3/7\n"))
    assert mesh.uv is None and mesh.materials[0].texture is None  # type: ignore[union-attr]
    assert mesh.notes[0] == "dropped stored texture coordinates: a face names texture coordinate 7 of 1"
    assert "no texture coordinates" in mesh.notes[1] and len(mesh.notes) == 2
    mesh = read_mesh(save(tmp_path / "a.obj", head + "vt 0.25\nf 1/1 2/1 3/1\n"))
    assert mesh.uv is not None and mesh.uv[0].tolist() == [0.25, 1.0]  # v is 0 where it is left out
    mesh = read_mesh(save(tmp_path / "a.obj", head + "f -4/-1 -3/-1 -2/-1\n"))
    assert mesh.uv is None and len(mesh.vertices) == 4


@pytest.mark.parametrize(
    ("line", "file", "options"),
    [
        ("map_Kd my image.png", "my image.png", ""),
        ("map_Kd -s 1 1 1 my image.png", "my image.png", "-s 1 1 1"),
        ("map_Kd -o -1 my image.png", "my image.png", "-o -1"),
        ("map_Kd -clamp on -mm 0 1 -t 0.5 0 a.png", "a.png", "-clamp on -mm 0 1 -t 0.5 0"),
        ("map_Kd C:\\art\\a.png", "a.png", ""),
        ("map_Kd /home/artist/a.png", "a.png", ""),
        ("map_Kd tex\\a.png", "tex/a.png", ""),
    ],
)
def test_obj_maps(tmp_path: Path, line: str, file: str, options: str) -> None:
    folder = tmp_path / "materials"
    (folder / "tex").mkdir(parents=True)
    save(folder / file, png())
    save(
        folder / "a.mtl",
        f"newmtl m\nKd 0.5 0.25 1\n{line}\nmap_Ks b.png\nbump c.png\nnewmtl unused\nmap_Kd no.png\nnewmtl n\n{line}\n",
    )
    lines = ["mtllib materials/a.mtl", "usemtl m", *sides()[0], "usemtl n", "f 1/1 2/2 3/3"]
    mesh = read_mesh(save(tmp_path / "a.obj", "\n".join(lines)))
    first, second = mesh.materials
    assert first is not None and first.texture is not None and first.base_color == (0.5, 0.25, 1.0)
    np.testing.assert_array_equal(first.texture.image, IMAGE)
    assert second is not None and second.texture is first.texture
    notes = ["material 'm': not read: map_Ks, bump"]
    if options:
        notes += [f"material '{name}': the options of map_Kd are not read: {options}" for name in "mn"]
    assert mesh.notes == tuple(notes)


# --- glTF ----------------------------------------------------------------------------------------------------


def attribute(scene: Gltf, name: str, array: NDArray[Any], **more: Any) -> None:
    """Give the first primitive of a scene an attribute."""
    component = {"u1": 5121, "u2": 5123, "f4": 5126}[array.dtype.str[1:]]
    kind = f"VEC{array.shape[1]}"
    accessor = scene.accessor(array, component, kind)
    scene.tree["accessors"][accessor] |= more
    scene.tree["meshes"][0]["primitives"][0]["attributes"][name] = accessor


COLOURS = np.arange(24).reshape(8, 3) * 10 + 3  # linear in glTF, as bytes
FLOATS = np.random.default_rng(6).random((8, 2)).astype("<f4")


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("kind", ["<f4", "<u1", "<u2"])
def test_gltf_colours_are_linear(tmp_path: Path, kind: str, channels: int) -> None:
    scale = {"<f4": 1 / 255, "<u1": 1, "<u2": 257}[kind]
    values = np.hstack((COLOURS, np.full((8, 1), 77)))[:, :channels] * scale
    scene = simple_gltf()
    padded = values.astype(kind)
    if kind != "<f4" and channels == 3:  # rows of three bytes or shorts are padded to whole words
        width = 4 if kind == "<u1" else 8
        rows = np.zeros((8, width), dtype=np.uint8)
        rows[:, : 3 * padded.itemsize] = np.ascontiguousarray(padded).view(np.uint8).reshape(8, -1)
        attribute(scene, "COLOR_0", rows, normalized=True)
        accessor = scene.tree["accessors"][-1]
        accessor |= {"componentType": 5121 if kind == "<u1" else 5123, "type": "VEC3"}
        scene.tree["bufferViews"][-1]["byteStride"] = width
    else:
        attribute(scene, "COLOR_0", padded, normalized=kind != "<f4")
    mesh = read_mesh(save(tmp_path / "a.glb", scene.glb()))
    assert mesh.colours is not None and mesh.notes == ()
    np.testing.assert_allclose(mesh.colours, COLOURS / 255, rtol=1e-6)
    np.testing.assert_array_equal(mesh.vertices, CUBE)


def textured(images: list[dict[str, Any]], info: dict[str, Any] | None = None, **texture: Any) -> Gltf:
    """A cube whose material has a base colour texture of the first image."""
    base = {"baseColorFactor": [0.5, 0.25, 1, 1], "baseColorTexture": {"index": 0, **(info or {})}}
    scene = simple_gltf(material=0)
    attribute(scene, "TEXCOORD_0", FLOATS)
    scene.tree["materials"] = [{"name": "wood", "pbrMetallicRoughness": base}]
    scene.tree |= {"images": images, "textures": [{"source": 0, **texture}]}
    return scene


def embedded(scene: Gltf, data: bytes) -> None:
    """Move the image of a scene into its buffer; after this, `accessor` would count views wrongly."""
    scene.tree["images"] = [{"bufferView": len(scene.tree["bufferViews"]), "mimeType": "image/png"}]
    scene.tree["bufferViews"].append({"buffer": 0, "byteOffset": len(scene.blob), "byteLength": len(data)})
    scene.blob += data + bytes(-len(data) % 4)


@pytest.mark.parametrize(
    "place", ["glb view", "gltf view", "data", "file", "encoded name", "external buffer"]
)
def test_gltf_images(tmp_path: Path, place: str) -> None:
    uri = "data:image/png;base64," + base64.b64encode(png()).decode()
    scene = textured([{"uri": {"data": uri, "encoded name": "my%20image.png"}.get(place, "my image.png")}])
    if "name" in place or place == "file":
        save(tmp_path / "my image.png", png())
    if "view" in place or "buffer" in place:
        embedded(scene, png())
    if place == "glb view":
        path = save(tmp_path / "a.glb", scene.glb())
    elif place == "external buffer":
        save(tmp_path / "a.bin", scene.blob)
        tree = scene.tree | {"buffers": [{"byteLength": len(scene.blob), "uri": "a.bin"}]}
        path = save(tmp_path / "a.gltf", json.dumps(tree))
    else:
        path = save(tmp_path / "a.gltf", scene.gltf())
    mesh = read_mesh(path)
    (part,) = mesh.materials
    assert part is not None and part.texture is not None and mesh.notes == ()
    assert part == PartMaterial("wood", (0.5, 0.25, 1.0), 1.0, 1.0, part.texture)
    np.testing.assert_array_equal(part.texture.image, IMAGE)
    np.testing.assert_array_equal(mesh.uv, FLOATS)
    assert mesh.coloured.tolist() == [True]


@pytest.mark.parametrize(
    ("kind", "normalized"), [("<u1", True), ("<u2", True), ("<u2", False), ("<u2", None)]
)
def test_gltf_integer_coordinates(tmp_path: Path, kind: str, normalized: bool | None) -> None:
    scene = textured([])
    stored = np.arange(16).reshape(8, 2).astype(kind)
    more = {} if normalized is None else {"normalized": normalized}
    attribute(scene, "TEXCOORD_0", stored, **more)
    if kind == "<u1":
        attribute(scene, "TEXCOORD_0", np.hstack((stored, stored)), **more)
        scene.tree["accessors"][-1]["type"] = "VEC2"
        scene.tree["bufferViews"][-1]["byteStride"] = 4
    mesh = read_mesh(save(tmp_path / "a.glb", scene.glb()))
    largest = {"<u1": 255, "<u2": 65535}[kind] if normalized else 1
    np.testing.assert_allclose(mesh.uv, stored / largest, rtol=1e-6)


def test_gltf_interleaved_and_mirrored(tmp_path: Path) -> None:
    """Positions, normals, colours and coordinates in rows of one buffer view, under a node that mirrors."""
    row = np.dtype([("p", "<f4", 3), ("n", "<f4", 3), ("c", "u1", 4), ("t", "<f4", 2)])
    rows = np.zeros(8, dtype=row)
    rows["p"], rows["n"], rows["t"], rows["c"][:, :3] = CUBE, OUTWARD, FLOATS, COLOURS
    scene = textured([])
    (primitive,) = scene.tree["meshes"][0]["primitives"]
    view = len(scene.tree["bufferViews"])
    scene.tree["bufferViews"].append(
        {"buffer": 0, "byteOffset": len(scene.blob), "byteLength": rows.nbytes, "byteStride": row.itemsize}
    )
    scene.blob += rows.tobytes()
    for name, field, component, kind in (
        ("POSITION", "p", 5126, "VEC3"),
        ("NORMAL", "n", 5126, "VEC3"),
        ("COLOR_0", "c", 5121, "VEC4"),
        ("TEXCOORD_0", "t", 5126, "VEC2"),
    ):
        primitive["attributes"][name] = len(scene.tree["accessors"])
        scene.tree["accessors"].append(
            {"bufferView": view, "byteOffset": row.fields[field][1], "componentType": component}  # type: ignore[index]
            | {"count": 8, "type": kind, "normalized": component == 5121}
        )
    embedded(scene, png())
    scene.tree["nodes"] = [{"mesh": 0, "scale": [1, 2, -1]}]
    mesh = read_mesh(save(tmp_path / "a.glb", scene.glb()))
    np.testing.assert_array_equal(mesh.vertices, CUBE * [1, 2, -1])
    np.testing.assert_array_equal(mesh.faces, CUBE_FACES[:, ::-1])
    np.testing.assert_allclose(mesh.colours, COLOURS / 255, rtol=1e-6)
    np.testing.assert_array_equal(mesh.uv, FLOATS)
    assert mesh.notes == ()


def test_gltf_parts_with_and_without(tmp_path: Path) -> None:
    scene = textured([])
    attribute(scene, "COLOR_0", (COLOURS / 255).astype("<f4"))
    parts = scene.tree["meshes"][0]["primitives"]
    parts.append(scene.primitive(CUBE + 3, CUBE_FACES))
    parts.append({**scene.primitive(CUBE + 6, CUBE_FACES), "material": 0})  # the texture, and no coordinates
    parts.append({**parts[0], "material": 1})
    parts[3]["attributes"] = {k: v for k, v in parts[0]["attributes"].items() if k != "COLOR_0"}
    scene.tree["materials"].append(dict(scene.tree["materials"][0], name="wood too"))
    embedded(scene, png())
    mesh = read_mesh(save(tmp_path / "a.glb", scene.glb()))
    assert mesh.colours is not None and mesh.uv is not None
    np.testing.assert_allclose(mesh.colours[:8], COLOURS / 255, rtol=1e-6)
    np.testing.assert_array_equal(mesh.colours[8:], 1)
    np.testing.assert_array_equal(mesh.uv[:8], FLOATS)
    np.testing.assert_array_equal(mesh.uv[8:24], 0)
    assert mesh.coloured.tolist() == [True, False, False, True]
    first, _, third, fourth = mesh.materials
    assert first is not None and third is not None and fourth is not None
    assert third == replace(first, texture=None) and fourth.texture is first.texture
    (note,) = mesh.notes
    assert note.startswith("material 'wood': texture 'image 0' cannot be read (the mesh has no texture coord")


def test_gltf_attributes_that_do_not_fit_are_dropped(tmp_path: Path) -> None:
    scene = textured([])
    attribute(scene, "COLOR_0", np.ones((5, 3), dtype="<f4"))
    attribute(scene, "TEXCOORD_0", FLOATS[:6])
    embedded(scene, png())
    mesh = read_mesh(save(tmp_path / "a.glb", scene.glb()))
    assert mesh.colours is None and mesh.uv is None and mesh.coloured.tolist() == [False]
    assert mesh.notes == (
        "dropped vertex colours: 5 for 8 vertices",
        "dropped texture coordinates: 6 for 8 vertices",
    )
    scene = simple_gltf()
    attribute(scene, "COLOR_0", np.ones((8, 3), dtype="<f4"), sparse={})
    mesh = read_mesh(save(tmp_path / "a.glb", scene.glb()))
    assert mesh.colours is None
    assert mesh.notes == ("dropped a COLOR_0 that is sparse, compressed or of an unknown type",)


def test_gltf_wrap_modes_and_transform(tmp_path: Path) -> None:
    moved = {"offset": [0.125, 0.5], "rotation": np.pi / 2, "scale": [2, 3]}
    scene = textured([], {"extensions": {"KHR_texture_transform": moved}}, sampler=1)
    embedded(scene, png())
    scene.tree["samplers"] = [{}, {"wrapS": 33071, "wrapT": 33648}]
    mesh = read_mesh(save(tmp_path / "a.glb", scene.glb()))
    assert mesh.notes == () and mesh.materials[0].texture.wrap == ("clamp", "mirror")  # type: ignore[union-attr]
    # A quarter turn counter-clockwise, v down, takes right (1, 0) to up (0, -1) and down (0, 1) to right (1, 0).
    u, v = FLOATS.T
    np.testing.assert_allclose(mesh.uv, np.stack((3 * v + 0.125, -2 * u + 0.5), axis=1), atol=1e-6)
    # The specification's example: this is the lower left quadrant of the image.
    moved |= {"offset": [0, 1], "scale": [0.5, 0.5]}
    uv = read_mesh(save(tmp_path / "a.glb", scene.glb())).uv
    assert uv is not None and uv[:, 0].max() <= 0.5 and uv[:, 1].min() >= 0.5


def test_gltf_specular_glossiness(tmp_path: Path) -> None:
    scene = textured([])
    embedded(scene, png())
    glossy = {"diffuseFactor": [0.5, 1, 1, 1], "glossinessFactor": 0.25, "diffuseTexture": {"index": 0}}
    glossy["specularGlossinessTexture"] = {"index": 0}
    scene.tree["materials"] = [{"name": "old", "extensions": {"KHR_materials_pbrSpecularGlossiness": glossy}}]
    mesh = read_mesh(save(tmp_path / "a.glb", scene.glb()))
    (part,) = mesh.materials
    assert part is not None and part.texture is not None
    assert part == PartMaterial("old", (0.5, 1.0, 1.0), 0.0, 0.75, part.texture)
    assert mesh.notes == ("material 'old': not read: specularGlossinessTexture",)


# --- what cannot be read -------------------------------------------------------------------------------------


def gltf_naming(folder: Path, name: str) -> Path:
    return save(folder / "a.gltf", textured([{"uri": name}]).gltf())


def obj_naming(folder: Path, name: str) -> Path:
    save(folder / "a.mtl", f"newmtl wood\nKd 0.5 0.25 1\nmap_Kd {name}\n")
    return save(folder / "a.obj", "\n".join(["mtllib a.mtl", "usemtl wood", *sides()[0]]))


def ply_naming(folder: Path, name: str) -> Path:
    return save(folder / "a.ply", ply_text(uv_columns(("s", "t")), f"comment TextureFile {name}\n"))


NAMING = [gltf_naming, obj_naming, ply_naming]


@pytest.mark.parametrize("naming", NAMING)
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("no.png", "no such file"),
        ("text.png", "none of PNG, JPEG"),
        ("cut.png", "truncated"),
        ("empty.png", "none of PNG, JPEG"),
        ("folder", "no such file"),
        ("../secret.png", "outside the mesh's folder"),
        ("link.png", "outside the mesh's folder"),
        ("/SECRET", "outside the mesh's folder"),
    ],
)
def test_an_image_that_cannot_be_read_is_a_note(
    tmp_path: Path, naming: Callable[[Path, str], Path], name: str, reason: str
) -> None:
    folder = tmp_path / "inside"
    (folder / "folder").mkdir(parents=True)
    save(tmp_path / "secret.png", png())
    save(folder / "text.png", "hello")
    save(
        folder / "cut.png", png(np.random.default_rng(1).integers(0, 256, (64, 64, 3), dtype=np.uint8))[:2000]
    )
    save(folder / "empty.png", "")
    (folder / "link.png").symlink_to(tmp_path / "secret.png")
    named = name.replace("/SECRET", str(tmp_path / "secret.png"))
    mesh = read_mesh(naming(folder, named))
    if naming is not gltf_naming and "secret" in named:
        reason = "no such file"  # the name alone is looked for, which is not inside either
    (note,) = mesh.notes
    assert f"texture '{named[:80]}' cannot be read (" in note and reason in note and "\n" not in note
    (part,) = mesh.materials
    if naming is ply_naming:
        assert part is None
    else:
        assert note.startswith("material 'wood': ") and note.endswith("; its factor is used alone")
        assert part is not None and part.texture is None and part.base_color == (0.5, 0.25, 1.0)
    assert mesh.coloured.tolist() == [False]


def test_references_of_a_gltf_that_lead_nowhere_are_notes(tmp_path: Path) -> None:
    scene = textured([{"uri": "a.png"}], {"index": 3})
    assert "the file refers to" in read_mesh(save(tmp_path / "a.glb", scene.glb())).notes[0]
    for image in (
        {},
        {"bufferView": 99},
        {"bufferView": 0},
        {"uri": "data:image/png;base64,AA"},
        {"uri": "\0"},
    ):
        scene = textured([image])
        (note,) = read_mesh(save(tmp_path / "a.glb", scene.glb())).notes
        assert note.startswith("material 'wood': texture '") and "cannot be read" in note
    scene = textured([])
    embedded(scene, png())
    scene.tree["bufferViews"][-1]["byteLength"] = 10**6
    text = scene.gltf()  # trimesh would refuse the view in a .glb or here, so the image alone is asked for
    resources = Resources(tmp_path / "a.gltf", json.loads(text), b"")
    with pytest.raises(ValueError, match="beyond its buffer"):
        resources.view(len(scene.tree["bufferViews"]) - 1)
    for change in ({"texCoord": 1}, {"extensions": {"KHR_texture_transform": {"texCoord": 1}}}):
        scene = textured([], change)
        embedded(scene, png())
        assert "other than TEXCOORD_0" in read_mesh(save(tmp_path / "a.glb", scene.glb())).notes[0]
    scene = textured([{"uri": "no.png"}])
    scene.tree["meshes"][0]["primitives"] *= 3
    assert len(read_mesh(save(tmp_path / "a.glb", scene.glb())).notes) == 1


def test_several_texture_files_of_a_ply_are_not_guessed_at(tmp_path: Path) -> None:
    save(tmp_path / "a.png", png())
    comments = "comment TextureFile a.png\ncomment TextureFile b.png\n"
    (note,) = read_mesh(save(tmp_path / "a.ply", ply_text(uv_columns(("s", "t")), comments))).notes
    assert "one of 2" in note


@pytest.mark.parametrize("kind", ["ply", "obj", "glb"])
def test_fuzz_reads_or_refuses(tmp_path: Path, kind: str) -> None:
    save(tmp_path / "a.png", png())
    save(tmp_path / "a.mtl", "newmtl m\nmap_Kd a.png\n")
    scene = textured([])
    attribute(scene, "COLOR_0", np.hstack((COLOURS, COLOURS[:, :1])).astype("u1"), normalized=True)
    embedded(scene, png())
    named = ply_binary("little").replace(b"element vertex", b"comment TextureFile a.png\nelement vertex")
    lines = ["mtllib a.mtl", "usemtl m", *(f"{line} 0.1 0.2 0.3" for line in sides()[0][:8]), *sides()[0][8:]]
    data = {"ply": named, "obj": "\n".join(lines).encode(), "glb": scene.glb()}[kind]
    rng = np.random.default_rng(7)
    outcomes = {"coloured": 0, "textured": 0, "refused": 0}
    for turn in range(200):
        changed = bytearray(data)
        for _ in range(rng.integers(1, 4)):
            # Every other time something a text may hold, to come further than the first line.
            value = rng.choice(list(b"0123456789.- /")) if turn % 2 else rng.integers(0, 256)
            changed[rng.integers(0, len(data))] = value
        try:
            mesh = read_mesh(save(tmp_path / f"x.{kind}", bytes(changed)))
        except InputError:
            outcomes["refused"] += 1
            continue
        every = np.arange(len(mesh.faces))
        found = np.concatenate(
            [mesh.base_colour(every, np.full((len(every), 3), 1 / 3)), mesh.vertex_colour(mesh.faces[:, 0])]
        )
        assert found.min() >= 0 and found.max() <= 1 + 1e-6 and not any("\n" in note for note in mesh.notes)
        outcomes["coloured"] += mesh.colours is not None
        outcomes["textured"] += any(part is not None and part.texture is not None for part in mesh.materials)
    assert min(outcomes.values()) > 5, outcomes


# --- checks --------------------------------------------------------------------------------------------------


def test_colours_are_checked() -> None:
    colours = np.full((8, 3), 0.5)
    colours[2, 1] = np.nan
    colours[3] = 1.0000001, 0.0, -1e-9  # rounding is not worth a note
    mesh = Mesh.from_arrays(CUBE, CUBE_FACES, colours=colours)
    assert mesh.colours is not None and mesh.colours.dtype == np.float32
    assert mesh.notes == ("replaced 1 NaN vertex colours of 8 by 1",)
    assert mesh.colours[2].tolist() == [0.5, 1.0, 0.5] and mesh.colours[3].tolist() == [1.0, 0.0, 0.0]
    colours[2, 1], colours[4] = 0.5, (255.0, -2.0, np.inf)
    mesh = Mesh.from_arrays(CUBE, CUBE_FACES, colours=colours)
    assert mesh.colours is not None and mesh.colours[4].tolist() == [1.0, 0.0, 1.0]
    assert mesh.notes == ("clipped 1 vertex colours of 8 to 0 to 1; they go from -2 to inf",)
    for wrong in (colours[:7], colours[:, :2], np.array(["x"] * 24).reshape(8, 3)):
        mesh = Mesh.from_arrays(CUBE, CUBE_FACES, colours=wrong)
        assert mesh.colours is None and mesh.notes[0].startswith(
            "dropped vertex colours: expected shape (8, 3)"
        )


def test_coordinates_are_checked() -> None:
    uv = FLOATS.astype(np.float64)
    uv[1, 0], uv[2, 1], uv[5, 0] = np.nan, np.inf, 1e300
    mesh = Mesh.from_arrays(CUBE, CUBE_FACES, uv=uv)
    assert mesh.uv is not None and mesh.uv.dtype == np.float32
    assert mesh.notes == ("replaced 3 NaN or infinite texture coordinates of 8 by 0",)
    np.testing.assert_array_equal(mesh.uv[[1, 2, 5]], 0)
    np.testing.assert_array_equal(mesh.uv[[0, 3, 4, 6, 7]], FLOATS[[0, 3, 4, 6, 7]])
    mesh = Mesh.from_arrays(CUBE, CUBE_FACES, uv=FLOATS[:7])
    assert mesh.uv is None and mesh.notes[0].startswith("dropped texture coordinates: expected shape (8, 2)")


def test_dropping_triangles_and_smoothing_keep_them() -> None:
    faces = np.vstack(([[0, 0, 1]], CUBE_FACES))
    mesh = Mesh.from_arrays(CUBE, faces, colours=COLOURS / 255, uv=FLOATS)
    np.testing.assert_allclose(mesh.colours, COLOURS / 255, rtol=1e-6)
    smooth = mesh.smooth()
    assert smooth.colours is mesh.colours and smooth.uv is mesh.uv and len(smooth.faces) == 12


@pytest.mark.parametrize("kind", ["ply", "obj", "gltf"])
def test_nan_in_a_file(tmp_path: Path, kind: str) -> None:
    """Colours and coordinates that are no numbers are repaired, and the geometry read."""
    if kind == "gltf":
        scene = simple_gltf()
        attribute(scene, "COLOR_0", np.full((8, 3), np.nan, dtype="<f4"))
        attribute(scene, "TEXCOORD_0", np.array([[np.inf, np.nan]] * 8, dtype="<f4"))
        path = save(tmp_path / "a.glb", scene.glb())
    elif kind == "obj":
        text = "v 0 0 0 nan 0 0\nv 1 0 0\nv 0 1 0\nvt nan 0\nf 1/1 2/1 3/1\n"
        path = save(tmp_path / "a.obj", text)
    else:
        path = save(
            tmp_path / "a.ply",
            ply_binary("little").replace(struct.pack("<f", 0.25), struct.pack("<f", np.nan)),
        )
    mesh = read_mesh(path)
    assert any("NaN or infinite texture coordinates" in note for note in mesh.notes)
    assert kind == "ply" or any("NaN vertex colours" in note for note in mesh.notes)
    assert mesh.uv is not None and np.isfinite(mesh.uv).all()


# --- textures ------------------------------------------------------------------------------------------------


def test_the_transfer_curve() -> None:
    np.testing.assert_allclose(linear(np.array(list(BYTES)) / 255), list(BYTES.values()), rtol=1e-9)
    values = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(linear(srgb(values)), values, atol=1e-7)


def test_lookup_at_texel_centres_is_exact() -> None:
    texture = Texture(IMAGE)
    height, width = IMAGE.shape[:2]
    j, i = np.mgrid[:height, :width].reshape(2, -1)
    found = texture.lookup(np.stack(((i + 0.5) / width, (j + 0.5) / height), axis=1))
    assert found.dtype == np.float32 and found.shape == (15, 3)
    np.testing.assert_allclose(found, linear(IMAGE[j, i] / 255), atol=1e-6)


def test_lookup_mixes_linear_light() -> None:
    image = np.zeros((2, 2, 3), dtype=np.uint8)
    image[0, 1] = image[1, 0] = 255, 128, 51
    found = Texture(image).lookup(np.array([[0.5, 0.25], [0.5, 0.5], [0.375, 0.25], [0.75, 0.25 + 0.125]]))
    full = np.array([1.0, BYTES[128], BYTES[51]])
    np.testing.assert_allclose(found, np.outer([0.5, 0.5, 0.25, 0.75], full), atol=1e-6)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(
    ("wrap", "texels"),
    [  # of texel centres -5 to 9 beside an image of four
        ("repeat", [3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1]),
        ("clamp", [0, 0, 0, 0, 0, 0, 1, 2, 3, 3, 3, 3, 3, 3, 3]),
        ("mirror", [3, 3, 2, 1, 0, 0, 1, 2, 3, 3, 2, 1, 0, 0, 1]),
    ],
)
def test_wrap_modes(wrap: Any, texels: list[int], axis: int) -> None:
    line = np.array([[0, 51, 128], [51, 128, 255], [128, 255, 0], [255, 0, 10]], dtype=np.uint8)
    image = line[None] if axis == 0 else line[:, None]
    others = [mode for mode in WRAPS if mode != wrap]
    texture = Texture(image, (wrap, others[0]) if axis == 0 else (others[0], wrap))
    uv = np.full((15, 2), 0.5)
    uv[:, axis] = (np.arange(-5, 10) + 0.5) / 4
    np.testing.assert_allclose(texture.lookup(uv), decoded(line)[texels], atol=1e-6)
    # On the edge itself: a repeat mixes both ends, the others show the end alone.
    uv = np.full((1, 2), 0.5)
    uv[:, axis] = 1.0
    expected = decoded(line)[[3, 0]].mean(axis=0) if wrap == "repeat" else decoded(line)[3]
    np.testing.assert_allclose(texture.lookup(uv)[0], expected, atol=1e-6)
    uv[:, axis] = 1e30
    assert np.isfinite(texture.lookup(uv)).all()


def test_images_of_every_kind() -> None:
    rgba = np.dstack((IMAGE, np.arange(15, dtype=np.uint8).reshape(3, 5)))
    np.testing.assert_array_equal(decode_image(png(rgba)), IMAGE)
    grey = IMAGE[..., 0]
    np.testing.assert_array_equal(decode_image(png(grey)), np.repeat(grey[..., None], 3, axis=2))
    deep = grey.astype(np.uint16) * 257 + 100  # of 65535, rounded to the nearest of 255
    np.testing.assert_array_equal(decode_image(png(deep))[..., 0], grey)
    palette = Image.fromarray(IMAGE).quantize(16)
    for transparent in ({}, {"transparency": bytes(range(16))}):
        file = io.BytesIO()
        palette.save(file, format="PNG", **transparent)
        np.testing.assert_array_equal(decode_image(file.getvalue()), np.asarray(palette.convert("RGB")))
    file = io.BytesIO()
    Image.fromarray(np.ones((2, 2), dtype=np.float32)).save(file, format="TIFF")
    with pytest.raises(ValueError, match="floating point"):
        decode_image(file.getvalue())


@pytest.mark.parametrize(
    ("image", "wrap"),
    [
        (IMAGE[..., :2], ("repeat", "repeat")),
        (IMAGE.astype(np.float32), ("repeat", "repeat")),
        (IMAGE[:0], ("repeat", "repeat")),
        (IMAGE, ("repeat", "border")),
    ],
)
def test_textures_of_other_shapes_are_refused(image: Any, wrap: Any) -> None:
    with pytest.raises(InputError, match="expected"):
        Texture(image, wrap)


# --- colours of points ---------------------------------------------------------------------------------------


def two_parts() -> Mesh:
    """Two triangles of four vertices, the second one's part textured."""
    mesh = Mesh.from_arrays(SQUARE, SQUARE_FACES, colours=decoded(CORNERS), uv=DOWN)
    part = PartMaterial("", (0.5, 0.5, 0.5), 0.0, 1.0)
    parts = np.array([0, 1], dtype=np.int32)
    return replace(
        mesh, parts=parts, materials=(part, replace(part, texture=Texture(IMAGE, ("clamp", "mirror"))))
    )


def test_base_colour_interpolates_and_multiplies() -> None:
    mesh = two_parts()
    weights = np.array([[1, 0, 0], [0.5, 0.25, 0.25], [0.2, 0.3, 0.5], [0, 0, 1]])
    colours, uv = decoded(CORNERS), DOWN
    found = mesh.base_colour(np.array([0, 0, 1, 1]), weights)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found[0], colours[0], rtol=1e-6)
    np.testing.assert_allclose(found[1], colours[0] / 2 + colours[1] / 4 + colours[2] / 4, rtol=1e-5)
    texture = mesh.materials[1].texture  # type: ignore[union-attr]
    assert texture is not None
    for row in (2, 3):
        corners = SQUARE_FACES[1]
        expected = weights[row] @ colours[corners] * texture.lookup((weights[row] @ uv[corners])[None])[0]
        np.testing.assert_allclose(found[row], expected, atol=1e-6)
    assert np.abs(found[2] - weights[2] @ colours[SQUARE_FACES[1]]).max() > 0.01  # the texture is no white
    bare = replace(mesh, colours=None, uv=None)
    np.testing.assert_array_equal(bare.base_colour(np.array([0, 1]), weights[:2]), 1)
    only = replace(mesh, colours=None).base_colour(np.array([0, 1]), weights[1:3])
    np.testing.assert_array_equal(only[0], 1)
    np.testing.assert_allclose(
        only[1], texture.lookup((weights[2] @ uv[SQUARE_FACES[1]])[None])[0], atol=1e-6
    )


def test_base_colour_stays_in_range_beside_an_edge() -> None:
    mesh = two_parts()
    found = mesh.base_colour(np.array([0]), np.array([[1 + 2e-7, -1e-7, -1e-7]]))
    assert found.min() >= 0 and found.max() <= 1


def test_vertex_colour_takes_the_part_of_the_last_face() -> None:
    mesh = two_parts()
    found = mesh.vertex_colour(np.array([3, 1, 0]))
    expected = decoded(CORNERS)[[3, 1, 0]]
    texture = mesh.materials[1].texture  # type: ignore[union-attr]
    assert texture is not None
    expected[[0, 2]] *= texture.lookup(
        DOWN[[3, 0]]
    )  # of the second face; vertex 1 belongs to the first alone
    np.testing.assert_allclose(found, expected, atol=1e-6)
    turned = replace(mesh, faces=mesh.faces[::-1], parts=mesh.parts[::-1])
    np.testing.assert_allclose(turned.vertex_colour(np.array([0]))[0], decoded(CORNERS)[0], rtol=1e-6)


def test_coloured_by_part() -> None:
    mesh = two_parts()
    assert mesh.coloured.dtype == np.bool_ and mesh.coloured.tolist() == [True, True]
    white = np.ones((4, 3), dtype=np.float32)
    assert replace(mesh, colours=white).coloured.tolist() == [False, True]
    assert replace(mesh, colours=white, uv=None).coloured.tolist() == [False, False]
    white[3, 2] = 0.5  # of the second face alone
    assert replace(mesh, colours=white, uv=None).coloured.tolist() == [False, True]
    assert replace(mesh, colours=None, uv=None).coloured.tolist() == [False, False]
    assert Mesh.from_arrays(SQUARE, SQUARE_FACES).coloured.tolist() == [False]


# --- bakes ---------------------------------------------------------------------------------------------------


def baked(mesh: Mesh, path: Path) -> Path:
    Bake.trace(mesh, rays=1).save(path)
    return path


def test_a_bake_keeps_colours_bit_for_bit(tmp_path: Path) -> None:
    mesh = two_parts()
    shared = mesh.materials[1]
    other = replace(shared, texture=Texture(IMAGE[::-1, :4].copy()))  # type: ignore[type-var]
    mesh = replace(mesh, materials=(None, shared, *mesh.materials[:1], shared, other))
    again = Bake.load(baked(mesh, tmp_path / "a.npz")).mesh
    for name in ("colours", "uv"):
        first, second = getattr(mesh, name), getattr(again, name)
        assert first.dtype == second.dtype and first.tobytes() == second.tobytes()
    textures = [part and part.texture for part in again.materials]
    assert textures[0] is None and textures[2] is None and again.materials[2] is not None
    assert textures[1] is not None and textures[1] is textures[3] and textures[4] is not None
    assert textures[1].wrap == ("clamp", "mirror") and textures[4].wrap == ("repeat", "repeat")
    assert textures[1].image.dtype == np.uint8
    np.testing.assert_array_equal(textures[1].image, IMAGE)
    np.testing.assert_array_equal(textures[4].image, IMAGE[::-1, :4])
    assert again.coloured.tolist() == mesh.coloured.tolist()
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        assert {"texture_0", "texture_1"} <= set(file.files) and "texture_2" not in file.files


def test_a_bake_without_colours_is_as_before(tmp_path: Path) -> None:
    path = baked(Mesh.from_arrays(CUBE, CUBE_FACES), tmp_path / "a.npz")
    with np.load(path) as file:
        names = {
            "format",
            "prtcl",
            "name",
            "vertices",
            "faces",
            "normals",
            "parts",
            "materials",
            "rays",
            "bits",
        }
        assert set(file.files) == names  # what the format had before it knew colours
    mesh = Bake.load(path).mesh
    assert mesh.colours is None and mesh.uv is None and mesh.coloured.tolist() == [False]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"colours": np.ones((3, 3), np.float32)}, "colours expected f4 of shape (4, 3)"),
        ({"colours": np.ones((4, 3))}, "colours expected f4"),
        ({"colours": np.full((4, 3), np.nan, np.float32)}, "colours are NaN"),
        ({"uv": np.ones((4, 3), np.float32)}, "uv expected f4 of shape (4, 2)"),
        ({"uv": np.full((4, 2), np.inf, np.float32)}, "uv are NaN or infinite"),
        ({"textures": np.array([0], np.int32)}, "textures expected i4 of shape (2)"),
        ({"textures": np.array([-1, 1], np.int32)}, "textures expected from -1 to 0"),
        ({"textures": np.array([-2, 0], np.int32)}, "textures expected from -1 to 0"),
        ({"textures": None}, "textures are not complete"),
        ({"wraps": np.array([[0, 3]], np.int32)}, "wraps expected from 0 to 2"),
        ({"wraps": np.array([[0, -1]], np.int32)}, "wraps expected from 0 to 2"),
        ({"wraps": np.array([[0, 0]] * 2, np.int32)}, "textures are not complete"),
        ({"wraps": None}, "textures expected from -1 to -1"),
        ({"texture_0": IMAGE.astype(np.float32)}, "texture_0 expected u1"),
        ({"texture_0": IMAGE[..., :2]}, "texture_0 expected u1"),
        ({"texture_0": IMAGE[:0]}, "textures without texels"),
        ({"texture_0": None}, "textures are not complete"),
        ({"texture_1": IMAGE}, "textures are not complete"),
    ],
)
def test_a_bake_whose_colours_do_not_fit_is_refused(
    tmp_path: Path, change: dict[str, Any], words: str
) -> None:
    path = baked(two_parts(), tmp_path / "a.npz")
    with np.load(path) as file:
        data = {**file, **change}
    np.savez(path, **{key: value for key, value in data.items() if value is not None})
    with pytest.raises(InputError) as caught:
        Bake.load(path)
    assert words in str(caught.value) and "again" in str(caught.value)
    assert len(str(caught.value).splitlines()) <= 2
