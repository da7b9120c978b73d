"""The command `flexx2`. Handles signals first; everything else is imported later."""

import errno
import os
import signal
import sys

from flexx2_sim_ros.errors import InputError, missing_library, shown_path
from flexx2_sim_ros.signals import exit_status, leave_on_signals

# Full disk or quota, file size limit, failed or closed device.
_WRITE_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)


def main(argv: list[str] | None = None) -> int:
    """
    Run the command line.

    Parameters
    ----------
    argv : list of str, optional
        Arguments; default those of the process. Signals are handled only with the default.

    Returns
    -------
    int
        Exit status: 0 for success, 2 for input that cannot be used. Ctrl-C and SIGTERM
        end the process with 130 and 143.

    """
    if argv is None:
        leave_on_signals()
        for stream in (sys.stdout, sys.stderr):
            # Names of files may have bytes that are not text.
            stream.reconfigure(errors='backslashreplace')  # type: ignore[union-attr]
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
    except (BrokenPipeError, SystemExit) as error:  # For example with `flexx2 modes | head -1`.
        # Rich leaves with status 1 then.
        if not any(isinstance(one, BrokenPipeError) for one in (error, error.__context__)):
            raise
        _drop_output()
        return exit_status(signal.SIGPIPE)
    except OSError as error:
        return _say(_describe(error))


def _say(error: str) -> int:
    print(f'flexx2: error: {error}', file=sys.stderr)
    return 2


def _describe(error: OSError) -> str:
    # An error of writing to standard output names no file, but neither do many others.
    cause = error.strerror or str(error) or type(error).__name__
    cause = f'{cause[:1].lower()}{cause[1:]}'
    if error.filename is not None:
        return f'{shown_path(error.filename)}: {cause}'
    if error.errno in _WRITE_ERRORS:  # Files are written inside `atomic.named`.
        _drop_output()
        return f'standard output: cannot be written: {cause}'
    return f'the operating system refused a request: {cause}'


def _drop_output() -> None:
    # Python writes the buffer again at exit, and would print a second error.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == '__main__':
    sys.exit(main())
