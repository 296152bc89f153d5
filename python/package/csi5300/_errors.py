"""The exceptions of this package, one family: :class:`Error`."""

from __future__ import annotations


class Error(Exception):
    """What this package raises. ``file`` and ``offset`` (bytes) say where, if that is known."""

    file: str | None
    offset: int | None

    def __init__(self, message: str, file: str | None = None, offset: int | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.file = file
        self.offset = offset

    def __str__(self) -> str:
        return self.message

    def __reduce__(self) -> tuple[type[Error], tuple[str, str | None, int | None]]:
        return (type(self), (self.message, self.file, self.offset))


class LogError(Error, OSError):
    """A log cannot be opened, or read further than ``offset``."""


class LogNotFoundError(LogError, FileNotFoundError):
    """There is no such log."""


class OptionError(Error, ValueError):
    """An argument makes no sense; the message names it."""


class OptionFileError(OptionError, OSError):
    """A file or folder that an argument names is not there or cannot be read."""


class TrajectoryError(Error, ValueError):
    """A trajectory cannot be read, or its poses make none."""


class TrajectoryFileError(TrajectoryError, OSError):
    """A trajectory's file is not there or cannot be read."""


class SceneError(Error, ValueError):
    """A scene cannot be read, or cannot be."""


class SceneFileError(SceneError, OSError):
    """A scene's file is not there or cannot be read, nor is there a built-in scene of this name."""


class CaptureError(Error):
    """The logs of a capture cannot be read to their ends."""


class LinkError(Error):
    """A link has no bearing; the message says why."""


class LiveError(Error, OSError):
    """The card or the served room cannot be listened to."""


class ExportError(Error, OSError):
    """A file cannot be written."""


class InternalError(Error):
    """A bug of this package."""
