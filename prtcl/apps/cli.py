"""The command line: `prtcl demo | render | relight | bake | info | occlusion | fit | view | brdf | bench | report | …`.

Exit status: 0 done, 1 the job failed, 2 the input or the command line was wrong. An error is one or two lines that
name the file or the option and say what to do.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from prtcl.apps.interrupts import deferred_interrupts
from prtcl.apps.parsers import parser
from prtcl.errors import PrtclError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    command = "prtcl"
    try:
        with deferred_interrupts():
            options = parser().parse_args(arguments)
            options.arguments = list(sys.argv[1:] if arguments is None else arguments)
        command = f"prtcl {options.command}"
        status: int = options.run(options)
        return status
    except PrtclError as error:
        print(f"{command}: {error}", file=sys.stderr)
        return error.exit_status
    except MemoryError as error:
        print(f"{command}: out of memory {error}; use fewer --levels or a smaller --size",
              file=sys.stderr)  # fmt: skip
        return 1
    except KeyboardInterrupt:
        print(f"{command}: interrupted; no output was left half written", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The reader of our output (head, a pager) went away; keep the interpreter from complaining at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        if os.environ.get("PRTCL_DEBUG"):
            raise
        if type(error).__module__.startswith("pyopencl"):
            print(
                f"{command}: the OpenCL device failed: {str(error).splitlines()[0]}\n"
                "try another --device, fewer --levels or a smaller --size; PRTCL_DEBUG=1 shows more",
                file=sys.stderr,
            )
            return 1
        print(
            f"{command}: {type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}\n"
            "this is a bug in prtcl or its OpenCL driver; PRTCL_DEBUG=1 shows the traceback",
            file=sys.stderr,
        )
        return 1
