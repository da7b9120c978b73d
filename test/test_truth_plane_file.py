"""The file `planes.yaml`: what cannot be in it, and outlines that are drawn into it."""

import re

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.truth.plane_file import plane_form, read_planes
from flexx2_sim_ros.view.outlines import save_outline
import pytest
import yaml

CORNERS = [[1.2, 2], [30, 2], [30, 40]]
DRAWN = ((1, 2), (30, 2), (30, 40))
BLOCKS = """\
schema: 1
planes:
- name: left  # mine
- name: floor
recordings:
  corner.npz:
    left:
      box: [1, 2, 3, 4]
      distance: 0.94 +- 0.003
    # after
    floor: null
"""


@pytest.mark.parametrize(
    'before',
    [
        '',
        BLOCKS,
        plane_form({'corner': {'left': 'a wall', 'floor': ''}, 'other': {'left': 'a door'}}),
        '{schema: 1, planes: [{name: left}], recordings: {corner: {left: {seed: [3, 4]}}}}',
        'schema: 1\nplanes:\n  - {name: left}\nrecordings: {}\n# end\n',
        'schema: 1\nplanes:\n- name: left\nrecordings:\n  corner:\n    left:\n',
    ],
)
@pytest.mark.parametrize('plane', ['left', 'floor', 'the "new" one: #2'])
def test_an_outline_takes_the_place_of_a_box(before, plane, tmp_path):
    path = tmp_path / 'planes.yaml'
    if before:
        path.write_text(before)
    old = yaml.safe_load(before or '{}')
    for recording in ('corner', 'new'):
        save_outline(path, recording, plane, CORNERS)
        (hint,) = (one for one in read_planes(path).seen_in(recording) if one.name == plane)
        assert (hint.outline, hint.box) == (DRAWN, ())
    text = path.read_text()
    for comment in ('# mine', '# after', '# a wall', '# a door', '# end', '#   distance  of'):
        assert (comment in before) == (comment in text)
    new = yaml.safe_load(text)
    assert [row for row in new['planes'] if row['name'] != plane] == [
        row for row in old.get('planes', []) if row['name'] != plane
    ]
    for recording, rows in old.get('recordings', {}).items():
        for name, row in rows.items():
            kept = {key: value for key, value in (row or {}).items() if key not in ('box', 'seed')}
            drawn_on = name == plane and recording.removesuffix('.npz') == 'corner'
            there = new['recordings'][recording][name]
            assert there == (
                {**kept, 'outline': [list(one) for one in DRAWN]} if drawn_on else row
            )


def test_a_file_that_is_not_of_planes_stays(tmp_path):
    path = tmp_path / 'planes.yaml'
    for text, said in (('schema: 2\n', 'schema: must be 1'), (BLOCKS, 'must be a list of 3')):
        path.write_text(text)
        with pytest.raises(InputError) as error:
            save_outline(path, 'corner', 'left', CORNERS[:2])
        assert said in str(error.value)
        assert path.read_text() == text
        assert [one.name for one in tmp_path.iterdir()] == ['planes.yaml']


@pytest.mark.parametrize(
    ('planes', 'changes', 'words'),
    [
        ([{'name': 'a', 'distance': 1200}], {}, 'looks like millimetres'),
        ([{'name': 'a', 'distance': '1.2 m'}], {}, 'must be a number, or text as 1.20 +- 0.01'),
        ([{'name': 'a', 'distance': '2.5 +- -1'}], {}, 'with a standard deviation above 0'),
        ([{'name': 'a', 'angles': {'b': 90}}], {}, "got 'b'"),
        ([{'name': 'a', 'colour': 1}], {}, "got 'colour'"),
        ([{'name': 'a'}, {'name': 'a'}], {}, 'must be unique'),
        ([], {}, 'must be a list of 1 to 20 planes'),
        ([{'name': 'a', 'seed': [1, 2], 'box': [1, 2, 3, 4]}], {}, 'must have one of seed, box'),
        ([{'name': 'a', 'outline': [[1, 2]]}], {}, 'must be a list of 3 to 100 corners'),
        ([{'name': 'a'}], {'recordings': {'corner0': {'b': None}}}, "got 'b'"),
        ([{'name': 'a'}], {'origin': 12}, 'at most 1 from the optical centre'),
        (
            [{'name': 'a', 'angles': {'b': 90}}, {'name': 'b', 'angles': {'a': 80}}],
            {},
            'must be the same in both planes',
        ),
        (
            [{'name': 'a', 'angles': {'b': '90 +- -1'}}, {'name': 'b'}],
            {},
            'with a standard deviation above 0',
        ),
    ],
)
def test_a_file_that_cannot_be_of_planes_is_one_sentence(tmp_path, planes, changes, words):
    path = tmp_path / 'planes.yaml'
    path.write_text(yaml.safe_dump({'schema': 1, 'planes': planes, **changes}))
    with pytest.raises(InputError, match=re.escape(words)):
        read_planes(path)
