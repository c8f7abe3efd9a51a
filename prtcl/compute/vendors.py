"""OpenCL implementations that come as Python packages but do not announce themselves.

The OpenCL loader reads a folder of .icd files, each of which names a library. PoCL's wheel puts its own where
pyopencl's loader looks; Intel's wheels (`pip install 'prtcl[intel]'`) leave one that names a folder of whoever built
them. So a folder of ours is shown to the loader, with all that the system has and Intel's library as well.
"""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
from importlib import metadata
from pathlib import Path

VARIABLES = ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH")
"""What a user sets to choose implementations: then nothing is added."""
SYSTEM = Path("/etc/OpenCL/vendors")
PACKAGE = "intel-opencl-rt"
LIBRARY = "libintelocl.so"


def intel_library() -> Path | None:
    """The library of Intel's CPU runtime, where its wheel is installed in this Python."""
    try:
        files = metadata.files(PACKAGE) or []
    except metadata.PackageNotFoundError:
        return None
    found = [Path(str(file.locate())).resolve() for file in files if file.name == LIBRARY]
    return next((path for path in found if path.is_file()), None)


def reveal() -> None:
    """Show Intel's wheel to the OpenCL loader; before the loader's first look, and once a process."""
    library = intel_library() if sys.platform.startswith("linux") else None
    if library is None or any(os.environ.get(name) for name in VARIABLES):
        return
    folder = Path(tempfile.mkdtemp(prefix="prtcl-icd-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for entry in sorted(SYSTEM.glob("*.icd")):
        shutil.copy(entry, folder)
    (folder / "prtcl-intel.icd").write_text(f"{library}\n", encoding="utf-8")
    os.environ[VARIABLES[0]] = str(folder)
