"""The command `flexx2`. Handles signals first; everything else is imported later."""

import os
import signal
import sys

from flexx2_sim_ros.errors import InputError, missing_library
from flexx2_sim_ros.signals import exit_status, leave_on_signals


def main(argv: list[str] | None = None) -> int:
    """
    Run the command line.

    Parameters
    ----------
    argv : list of str, optional
        Arguments, the process's when left out. Only then are signals handled.

    Returns
    -------
    int
        Exit status: 0 for success, 2 for something given that cannot be used. Ctrl-C and SIGTERM
        end the process with 130 and 143.

    """
    if argv is None:
        leave_on_signals()
        for stream in (sys.stdout, sys.stderr):
            # Names of files may hold what no text can.
            stream.reconfigure(errors='backslashreplace')  # type: ignore[union-attr]
    from flexx2_sim_ros.atomic import reason
    from flexx2_sim_ros.cli.commands import run

    try:
        try:
            return run(argv)
        except ModuleNotFoundError as error:
            raise missing_library(error) from error
        finally:
            sys.stdout.flush()
    except InputError as error:
        return _say(str(error))
    except BrokenPipeError:  # As of `flexx2 modes | head -1`.
        _drop_output()
        return exit_status(signal.SIGPIPE)
    except OSError as error:
        _drop_output()
        return _say(f'{error.filename or "standard output"}: {reason(error)}')


def _say(error: str) -> int:
    print(f'flexx2: error: {error}', file=sys.stderr)
    return 2


def _drop_output() -> None:
    # What waits in the buffer cannot be written at the end either.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == '__main__':
    sys.exit(main())
