"""The one exception that is meant for a person rather than a programmer."""


class CadenzaError(Exception):
    """Something the user gave cannot be used.

    The message is one line: what is wrong, where, and what to do about it. The command line
    prints it without a traceback and exits with status 2.
    """


class CadenzaWarning(UserWarning):
    """Something that is done all the same, though not as one may expect.

    The message is one line. The command line prints it without a traceback.
    """
