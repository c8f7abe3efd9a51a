"""The exceptions prtcl raises, each a one- or two-line message a person can act on.

Every message names the file or the argument, what was expected, what came, and what to do. The command
line prints the message alone and exits with `exit_status`; a traceback there is a bug.
"""


class PrtclError(Exception):
    """The job failed, though what was asked for was well formed."""

    exit_status = 1


class InputError(PrtclError, ValueError):
    """An argument, a file or the command line is wrong."""

    exit_status = 2


class DeviceError(PrtclError):
    """No OpenCL device fits, or the device refused the work."""


class KernelBuildError(DeviceError):
    """An OpenCL program did not compile; the message holds file, device, defines and the compiler's log."""
