"""
Labels under seal.

Before anything runs, all labels are written to a folder of their own, with a salt, and their
SHA-256 is published beside the results. Cases carry opaque ids in an order that the salt decides.
Whoever scores shows that the labels are still the ones committed to.
"""

from dataclasses import dataclass
import hashlib
import json
from pathlib import Path
import secrets
from typing import Any

from flexx2_sim_ros.atomic import output_folder, write_text
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.validation.benchmark.design import Planned

COMMITMENT = 'commitment.json'
_LABELS = 'labels.json'


@dataclass(frozen=True)
class Sealed:
    """
    The labels, opened.

    Attributes
    ----------
    cases : dict of str to Planned
        By opaque id, in the order in which they run.
    digest : str
        SHA-256 of salt and labels, hexadecimal.

    """

    cases: dict[str, Planned]
    digest: str


def seal(design: list[Planned], sealed: Path, public: Path, facts: dict[str, Any]) -> Sealed:
    """
    Write labels and commitment, or take up those of a run that was broken off.

    Parameters
    ----------
    design : list of Planned
        All cases.
    sealed, public : pathlib.Path
        Folders for the labels and for the commitment.
    facts : dict
        Goes into the commitment as it is: date, version, seed set.

    Returns
    -------
    Sealed

    Raises
    ------
    InputError
        When the folders hold another design's labels.

    """
    if (sealed / _LABELS).is_file():
        opened = open_seal(sealed, public)
        wanted = sorted(json.dumps(case.to_json(), sort_keys=True) for case in design)
        found = sorted(
            json.dumps(case.to_json(), sort_keys=True) for case in opened.cases.values()
        )
        if wanted != found:
            raise InputError(
                f'{sealed}: --out must be empty or of a run with the same options, got the '
                'labels of another benchmark'
            )
        return opened
    salt = secrets.token_hex(16)
    named = {_digest(f'{salt}/{index}')[:12]: case.to_json() for index, case in enumerate(design)}
    text = json.dumps(
        {'salt': salt, 'cases': dict(sorted(named.items()))}, sort_keys=True, indent=1
    )
    output_folder(public)
    output_folder(sealed)
    write_text(
        public / COMMITMENT,
        json.dumps(
            {'schema': 1, 'sha256': _digest(text), 'cases': len(design), **facts}, indent=1
        ),
    )
    # Last: without the labels, a run broken off here starts anew.
    write_text(sealed / _LABELS, text)
    return open_seal(sealed, public)


def open_seal(sealed: Path, public: Path) -> Sealed:
    """
    Read the labels.

    Raises
    ------
    InputError
        When they cannot be read, or are not the ones committed to.

    """
    try:
        text = (sealed / _LABELS).read_text()
        commitment = json.loads((public / COMMITMENT).read_text())
        labels = json.loads(text)
    except (OSError, ValueError) as error:
        raise InputError(f'{sealed}: labels or commitment cannot be read: {error}') from error
    digest = _digest(text)
    if commitment.get('sha256') != digest:
        raise InputError(
            f'{sealed / _LABELS}: SHA-256 is {digest}, the commitment says '
            f'{commitment.get("sha256")}: these are not the labels of this run'
        )
    return Sealed(
        {name: Planned.from_json(case) for name, case in labels['cases'].items()}, digest
    )


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
