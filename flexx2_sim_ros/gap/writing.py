"""The files of a diagnosis, written whole or not at all."""

from collections.abc import Sequence
import json
import os
from pathlib import Path
import shutil
import tempfile
from typing import Any

from flexx2_sim_ros.effects import Effect, save_effects
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap.confirm import Outcome
from flexx2_sim_ros.gap.decide import Decision
from flexx2_sim_ros.gap.model import Model
from flexx2_sim_ros.gap.report import page

FILES = ('diagnosis.json', 'effects.yaml', 'report.html')


def check_folder(folder: Path) -> None:
    """
    Raise `InputError` where `write` could not write, before there is anything to be written.

    Parameters
    ----------
    folder : pathlib.Path
        It need not be there yet.

    """
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f'--out: {folder}: cannot be written to: found that {there} is '
                         + ('read-only' if there.is_dir() else 'a file') + ', wanted a folder')
    for name in FILES:
        if (folder / name).is_dir():
            raise InputError(f'--out: {folder / name}: found a folder, wanted to write a file')


def write(folder: Path, table: dict[str, Any], effects: Sequence[Effect], model: Model,
          decision: Decision, confirmed: Sequence[Outcome]) -> None:
    """
    Write ``diagnosis.json``, ``effects.yaml`` and ``report.html``.

    Parameters
    ----------
    folder : pathlib.Path
        Made if it is not there; the three files in it are replaced.
    table : dict
        The diagnosis.
    effects : sequence of Effect
        What explains the gap.
    model, decision, confirmed
        For the report.

    Raises
    ------
    InputError
        When the folder cannot be written to.

    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix='.diagnosis-', dir=folder))
    except OSError as error:
        raise InputError(f'--out: {folder}: cannot be written to: {error}') from error
    try:
        text = json.dumps(table, indent=2, allow_nan=False)
        (scratch / FILES[0]).write_text(text + '\n', encoding='utf-8')
        save_effects(scratch / FILES[1], effects, _comment(table))
        (scratch / FILES[2]).write_text(page(table, model, decision, confirmed),
                                        encoding='utf-8', errors='backslashreplace')
        for name in FILES:
            (scratch / name).chmod(0o644)
            (scratch / name).replace(folder / name)
    except OSError as error:
        raise InputError(f'--out: {folder}: cannot be written to: {error}') from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _comment(table: dict[str, Any]) -> str:
    names = ', '.join(row['name'] for row in table['effects']) or 'no effect'
    if 'patch' in table:
        return ('PATCH WITHOUT A CAUSE: flexx2 gap diagnose found a gap that no effect explains.\n'
                f'Bias, noise and loss binned over {table["patch"]["covariate"]}; takes '
                f'{table["patch"]["shrink"]:.0%} of the gap in these off')
    gap = table['gap']
    lines = [f'flexx2 gap diagnose: {table["verdict"]}: {names}']
    if gap['held_out'] and table['effects']:
        low, high = gap['interval']
        lines.append(f'takes {gap["shrink"]:.0%} of the gap off recordings it was not fitted to '
                     f'(90 % interval {low:.0%} to {high:.0%})')
    return '\n'.join(lines)
