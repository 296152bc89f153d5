"""The exceptions of this package, one family: :class:`Error`."""

from __future__ import annotations


class Error(Exception):
    """Base of all exceptions of this package. ``file`` and ``offset`` (bytes) give the place, if known."""

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
    """A log cannot be opened, or cannot be read beyond ``offset``."""


class LogNotFoundError(LogError, FileNotFoundError):
    """There is no such log."""


class OptionError(Error, ValueError):
    """An argument is invalid; the message names it."""


class OptionFileError(OptionError, OSError):
    """A file or folder named by an argument does not exist or cannot be read."""


class TrajectoryError(Error, ValueError):
    """A trajectory cannot be read, or its poses are invalid."""


class TrajectoryFileError(TrajectoryError, OSError):
    """A trajectory's file does not exist or cannot be read."""


class SceneError(Error, ValueError):
    """A scene cannot be read, or is invalid."""


class SceneFileError(SceneError, OSError):
    """A scene's file does not exist or cannot be read, and no built-in scene has this name."""


class CaptureError(Error):
    """The logs of a capture cannot be read to their ends."""


class LinkError(Error):
    """A link has no bearing; the message says why."""


class LiveError(Error, OSError):
    """The card or the served room is not available."""


class ExportError(Error, OSError):
    """A file cannot be written."""


class InternalError(Error):
    """A bug of this package."""
