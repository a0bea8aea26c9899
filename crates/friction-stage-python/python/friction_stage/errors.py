"""What can go wrong, with the words of the command line.

Every exception of this package is a ``FrictionStageError``; where a value that was given is the
reason, it is a ``ValueError`` too.
"""


class FrictionStageError(Exception):
    """Something that this package refuses or cannot do."""


class ModelError(FrictionStageError, ValueError):
    """A model, a catalogue or an effect that cannot be read or that no stage could have."""


class MotionError(FrictionStageError, ValueError):
    """A motion that no controller can follow."""


class ControllerError(FrictionStageError, ValueError):
    """Settings that no controller can have, or a rate that no stage runs at."""


class RecordingError(FrictionStageError, ValueError):
    """A recording, a mapping or columns that cannot be read as signals of a stage."""


class IdentificationError(FrictionStageError, ValueError):
    """Recordings from which nothing can be identified."""


class FitError(FrictionStageError, ValueError):
    """Recordings of a measuring rig from which no guide can be fitted."""


class ExperimentError(FrictionStageError, ValueError):
    """An experiment that does not exist, or cannot be run on a specimen."""


class SelectionError(FrictionStageError, ValueError):
    """An application or a catalogue from which no guide can be chosen."""


class SweepError(FrictionStageError, ValueError):
    """Keys or values that cannot be swept."""


class FleetError(FrictionStageError, ValueError):
    """A job that cannot be run as it is given, or results that are not of this job."""


class OtherJobError(FleetError):
    """Results that are of another job or of another version."""
