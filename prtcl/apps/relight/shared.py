"""A batch's folder as a worker of the run sees it that holds the folder."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from prtcl.apps.cluster import over
from prtcl.apps.relight.folder import Failed, Folder
from prtcl.apps.relight.lock import unchanged
from prtcl.apps.relight.manifest import MANIFEST


class Shared(Folder):
    """Files are written by the worker, and recorded by the run.

    A worker may outlive its run. Then the folder may be another's, with images of the same names, and nothing of the
    worker's may come into it. So a file gets its name while the manifest is held against being replaced, and only if
    it is still the manifest of the worker's job.

    Attributes
    ----------
    made : numbers of the images that are whole, and the digests of their files
    """

    def __init__(self, path: Path, manifest: dict[str, Any]) -> None:
        super().__init__(path, manifest)
        self.made: list[tuple[int, dict[str, str]]] = []

    def record(self, number: int, digests: dict[str, str]) -> None:
        """Keep for the run that an image is done."""
        self.made.append((number, digests))

    @contextmanager
    def naming(self) -> Iterator[None]:
        """While the manifest is this job's, and its run is not over.

        Raises
        ------
        PrtclError
            If it is not, or the folder is not there at all.
        """
        with unchanged(self.path / MANIFEST, alone=False) as file:
            # The fingerprint stands in one of the first lines (`prtcl.apps.relight.manifest.laid_out`).
            if file is None or json.dumps(self.manifest["job"]).encode() not in os.pread(file, 4096, 0):
                raise Failed(
                    f"{self.path}: {MANIFEST} there is not this job's\n"
                    "name a folder with -o that all machines share, by one path"
                )
            if over():
                raise Failed(f"{self.path}: the run that writes here is over")
            yield
