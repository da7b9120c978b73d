"""
Sealed labels.

Before the run, all labels and a salt are written to a separate folder, and their SHA-256 is
written beside the results. Cases have opaque names whose order, within each half of the design,
depends on the salt. The scorer checks that the labels still have this SHA-256.
"""

from dataclasses import dataclass
import hashlib
import json
from pathlib import Path
import secrets
from typing import Any

from flexx2_sim_ros.atomic import output_folder, write_text
from flexx2_sim_ros.errors import InputError
from study.benchmark.design import Planned

COMMITMENT = 'commitment.json'
_LABELS = 'labels.json'


@dataclass(frozen=True)
class Sealed:
    """
    The labels, read and checked.

    * `cases`: by opaque name, in the order in which they run: random within each half of the
      design
    * `digest`: SHA-256 of salt and labels, as hexadecimal digits
    """

    cases: dict[str, Planned]
    digest: str


def seal(design: list[Planned], sealed: Path, public: Path, facts: dict[str, Any]) -> Sealed:
    """
    Write labels and commitment, or read those of an interrupted run.

    * `sealed`, `public`: folders for the labels and for the commitment
    * `facts`: further entries of the commitment: date, version, seed set

    Raises InputError when the folders contain the labels of another design.
    """
    if (sealed / _LABELS).is_file():
        opened = open_seal(sealed, public)
        if sorted(one.key for one in design) != sorted(one.key for one in opened.cases.values()):
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
    # Last: a run that was interrupted before this line starts again.
    write_text(sealed / _LABELS, text)
    return open_seal(sealed, public)


def open_seal(sealed: Path, public: Path) -> Sealed:
    """
    Read the labels.

    Raises InputError when they cannot be read, or their SHA-256 differs from the commitment.
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
    cases = {name: Planned.from_json(case) for name, case in labels['cases'].items()}
    return Sealed(dict(sorted(cases.items(), key=lambda item: (item[1].half, item[0]))), digest)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
