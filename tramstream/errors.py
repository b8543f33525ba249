"""Every exception of tramstream. Dirty input is data, not an exception.

Exceptions mean a bug, a bad configuration, a lost device or an unreadable file. Each carries one
sentence that names the field, file or device and the cure; the command line prints that sentence.
"""

from __future__ import annotations


class TramstreamError(Exception):
    """Root of the tree. `exit_status` is what the command line ends with.

    Parameters
    ----------
    reason : str
        What is wrong.
    cure : str
        What to do about it; stands behind a semicolon in the sentence.
    """

    exit_status = 2

    def __init__(self, reason: str = "", cure: str = "") -> None:
        super().__init__(f"{reason}; {cure}" if cure else reason)
        self.reason = reason
        self.cure = cure


class ConfigError(TramstreamError):
    """A configuration that cannot be used; the sentence names the path of the field."""


class DeviceError(TramstreamError):
    """A device that is missing, lost or refuses; the loop opens it again."""


class BusError(TramstreamError):
    """No bus, or no router on it."""


class NodeError(TramstreamError):
    """A node that did not start; carries its exit status on."""

    def __init__(self, text: str, status: int) -> None:
        super().__init__(text)
        self.exit_status = status if status > 0 else 1


class RecordError(TramstreamError):
    """A record that cannot be read as asked."""


class DamagedRecordError(RecordError):
    """A record of which something is lost; what could be saved was saved."""

    exit_status = 3


class MachineCodeError(TramstreamError):
    """Kernels that could not be compiled."""


class CheckFailedError(TramstreamError):
    """The check asked for does not hold."""

    exit_status = 1


class UnknownNameError(RecordError, KeyError):
    """A key or column that a record does not have; near names are offered."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class MissingPackageError(TramstreamError, ImportError):
    """A package that only this needs, and that is not installed."""


class LeftOutWarning(UserWarning):
    """Something of a record, or of its reprocessing, is not in what was handed out."""
