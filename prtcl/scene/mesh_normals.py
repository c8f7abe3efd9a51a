"""Normals worked out from the triangles."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray


def face_vectors(vertices: NDArray[np.float64], faces: NDArray[Any]) -> NDArray[np.float64]:
    """Return each triangle's normal by its winding, as long as twice its area.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int

    Returns
    -------
    (m, 3) float64
    """
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


def vertex_normals(
    vertices: NDArray[np.float64], faces: NDArray[Any], weight: Literal["area", "angle"]
) -> NDArray[np.float64]:
    """Return unit vertex normals, the weighted mean of the triangles that share the vertex.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int
        Without degenerate triangles.
    weight : "area" or "angle"
        By the area of the triangle, or by its angle at the vertex, which makes the result independent of how
        flat surfaces are cut into triangles.

    Returns
    -------
    (n, 3) float64
        Where the mean vanishes, as on a sheet with two sides, the normal of one of the triangles; at vertices
        that no triangle uses, +z.
    """
    vectors = face_vectors(vertices, faces)
    units = normalised(vectors)
    sums = np.zeros_like(vertices)
    for corner in range(3):
        index = faces[:, corner]
        if weight == "area":
            shares = vectors
        else:
            to_next = vertices[faces[:, (corner + 1) % 3]] - vertices[index]
            to_last = vertices[faces[:, (corner + 2) % 3]] - vertices[index]
            # atan2 stays exact at needle angles, where arccos of a dot product does not.
            sine = np.linalg.norm(np.cross(to_next, to_last), axis=1)
            cosine = np.einsum("ij,ij->i", to_next, to_last)
            shares = units * np.arctan2(sine, cosine)[:, None]
        for axis in range(3):
            sums[:, axis] += np.bincount(index, weights=shares[:, axis], minlength=len(vertices))
    largest = np.zeros(len(vertices))
    lengths = np.linalg.norm(vectors, axis=1) if weight == "area" else np.ones(len(faces))
    fallback = np.zeros_like(vertices)
    fallback[:, 2] = 1.0
    for corner in range(3):
        np.maximum.at(largest, faces[:, corner], lengths)
        fallback[faces[:, corner]] = units
    # What remains of opposite normals after rounding has no meaning.
    vanished = np.linalg.norm(sums, axis=1) <= 1e-9 * largest
    return np.where(vanished[:, None], fallback, normalised(sums))


def normalised(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scale rows to length 1 and leave rows of zeros.

    Parameters
    ----------
    vectors : (n, 3) float64
        Finite.

    Returns
    -------
    (n, 3) float64
    """
    # Dividing by the largest component first keeps very small and very large rows from under- or overflowing.
    largest = np.abs(vectors).max(axis=1, keepdims=True, initial=0.0)
    scaled: NDArray[np.float64] = np.divide(vectors, largest, out=np.zeros_like(vectors), where=largest > 0)
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    units: NDArray[np.float64] = np.divide(scaled, length, out=np.zeros_like(scaled), where=length > 0)
    return units
