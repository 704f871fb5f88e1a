"""Exceptions of the whole distribution; each message says what was expected, what came and what to do."""


class CloudfitError(Exception):
    """Base of every error that cloudfit raises on purpose."""


class InputError(CloudfitError):
    """A file or an argument that cannot be used; the command line turns it into exit code 3."""


class PhotographError(InputError):
    """A photograph that cannot be read or analysed; names the file and the reason."""


class VolumeError(InputError):
    """A density volume that cannot be read or is not a density (NaN, infinite, negative, wrong shape)."""


class CameraError(InputError):
    """A camera whose numbers do not describe a view."""


class ParameterError(InputError):
    """A rendering parameter outside the domain in which the formula holds."""


class SceneError(InputError):
    """A scene, a mesh or a scene file that cannot be rendered; names the file or the part, and the reason."""


class MissingExtraError(CloudfitError):
    """An optional part of the installation that is needed here; says how to install it."""


class ResultError(InputError):
    """A result file that is missing, truncated, foreign or of another version."""


class StoreError(CloudfitError):
    """A stored table that is stale, truncated or foreign; callers rebuild it."""
