"""Write the files of a diagnosis, whole or not at all."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flexx2_sim_ros.atomic import as_json, output_folder, whole_files, write_text
from flexx2_sim_ros.effects import Effect, of_role, save_effects
from flexx2_sim_ros.effects.registry import map_file
from flexx2_sim_ros.effects.tables import PixelMap
from flexx2_sim_ros.gap.features.confirm import Outcome
from flexx2_sim_ros.gap.forms.calibrating import Calibrated
from flexx2_sim_ros.gap.inference.decide import Decision
from flexx2_sim_ros.gap.inference.model import Model
from flexx2_sim_ros.gap.report.age import age_words, arrival_of, with_delay
from flexx2_sim_ros.gap.report.page import page
from flexx2_sim_ros.gap.report.text import moved
from flexx2_sim_ros.gap.report.words import camera_effects, correction, imitation, reduction

FILES = ('diagnosis.json', 'effects.yaml', 'report.html')


def write(
    folder: Path,
    table: dict[str, Any],
    effects: Sequence[Effect],
    model: Model,
    decision: Decision,
    confirmed: Sequence[Outcome],
    calibrated: Calibrated | None,
) -> None:
    """
    Write ``diagnosis.json``, ``effects.yaml`` and ``report.html``.

    The folder is created if it does not exist; the files in it are replaced. Maps are in files
    beside these, as `save_effects` names them. ``effects.yaml`` has the effects of the camera: a
    pose error that was found belongs to these recordings, and is different in others. Raises
    `InputError` when the folder cannot be written to.
    """
    with whole_files(output_folder(folder)) as part:
        write_text(part / FILES[0], as_json(_with_files(table, effects)))
        camera = [one for one in effects if one.role != 'pose']
        late = with_delay(camera, arrival_of(table['age']))
        save_effects(part / FILES[1], late, comment(table))
        write_text(part / FILES[2], page(table, model, decision, confirmed, calibrated))


def _with_files(table: dict[str, Any], effects: Sequence[Effect]) -> dict[str, Any]:
    # Names of files instead of maps.
    rows = {row['name']: {**row, 'parameters': {**row['parameters']}} for row in table['effects']}
    for effect in effects:
        for name, one in effect.forms.items():
            if isinstance(one, PixelMap) and effect.name in rows:
                rows[effect.name]['parameters'][name] = map_file(effect.name)
    return {**table, 'effects': list(rows.values())}


def comment(table: dict[str, Any]) -> str:
    """Return what ``effects.yaml`` says above its effects."""
    names = ', '.join(row['name'] for row in table['effects']) or 'no effect'
    if 'patch' in table:
        cause = 'flexx2 gap diagnose: no effect of the catalogue explains the gap'
        if table['patch']['offered']:
            cause = f'PATCH WITHOUT A CAUSE: {cause}'
        return '\n'.join([cause, *correction(table), *age_words(table['age'])])
    lines = [f'flexx2 gap diagnose: {table["verdict"]}: {names}']
    if camera_effects(table):
        gap = table['gap']
        lines += [moved(gap['shrink'], 'the gap'), *reduction(gap), *imitation(table)]
    if any(row['name'] == of_role('pose').name for row in table['effects']):
        lines.append(
            'pose_error is not in here: it is no effect of the camera. Correct the poses.'
        )
    return '\n'.join([*lines, *age_words(table['age'])])
