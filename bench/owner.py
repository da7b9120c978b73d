"""
Which effects are found where `flexx2 gap truth` makes the ground truth: ``python -m bench.owner``.

Blind cameras with one effect of usual strength, or none, record what an owner has: a scanned room
(rough poses), walks in it with motion capture, a chessboard, and corners whose planes a tape
measured. Ground truth is made of the recordings without theirs, and both are diagnosed: with the
exact clean depth of the blind camera, and with what was made. Development seeds only.
"""

import argparse
from dataclasses import replace
import json
import math
from pathlib import Path
import resource
import time

from bench.planes import describe, TAPE, VIEWS
from flexx2_sim_ros.atomic import scratch_folder
from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.gap import diagnose
from flexx2_sim_ros.physics.poses import Pose
from flexx2_sim_ros.truth import BoardRequest, make_truth, PlaneRequest, PoseSource, RoomRequest
import numpy as np
from study.benchmark import DEVELOPMENT
from study.blind import BlindCamera, CATALOGUE, SceneSet
from study.blind.campaign import Case
from study.blind.meshes import mesh_pose, write_mesh
from study.blind.rooms import Path as Way
from study.blind.rooms import Scene
from study.blind.scanned import off, ScannedCamera
from study.blind.scene_set import SceneKey
from study.blind.shapes import BOX, CHECKER, MOTTLE, pack, ROOM, Shape

_FIRST = 400_000  # of the seeds of these cameras
_MODE, _FRAMES, _ROOM_VIEWS = 'Mode_9_30fps', 12, 6
_NEED_MOTION = 'time_offset', 'motion_artefact', 'motion_dropout'
_MOCAP = 0.002, 0.2  # metres, degrees
_SQUARE = 0.06  # metres; the chessboard has 10 x 8 squares
# Distance in metres, yaw and pitch of the board in degrees.
_BOARDS = (
    (0.6, 25, 5),
    (0.75, -30, 10),
    (0.9, 10, -30),
    (1.05, -20, -15),
    (1.2, 35, 0),
    (0.8, 5, 25),
)
_EXPECTED = 'right', 'later', 'not decidable', 'unknown', 'wrong'


def scan(effects, seed, folder):
    """Record a scanned room from places whose poses are known to 5 cm and 3 degrees."""
    camera = ScannedCamera(seed, effects, _ROOM_VIEWS, _FRAMES, 112, 86, _MODE)
    rng = np.random.default_rng(seed)
    poses = tuple(
        tuple(Pose(*off(camera.poses(i)[0], 0.05, 3.0, rng)).numbers()) for i in range(_ROOM_VIEWS)
    )
    return camera.camera, _room(camera, folder, poses=poses)


def motion_capture(effects, seed, folder):
    """Record walks in a scanned room, whose poses motion capture gives."""
    camera = ScannedCamera(seed, effects, _ROOM_VIEWS, _FRAMES, 112, 86, _MODE, moving=True)
    rng, poses = np.random.default_rng(seed), folder / 'poses'
    poses.mkdir()
    for i, start in enumerate(camera.camera.stamps):
        # One error for all frames, as of markers that are seen from one side.
        sizes = np.repeat([_MOCAP[0], math.radians(_MOCAP[1])], 3)
        wrong, path = rng.standard_normal(6) * sizes, camera.camera.scenes.scenes[i].path
        rows = []
        for after in np.linspace(-0.3, _FRAMES / 30 + 0.3, 100):
            pose = Pose(*mesh_pose(path.pose(float(after)))).moved(wrong)
            rows.append([start + after, *pose.numbers()])
        np.savetxt(poses / f'{i}.txt', rows, fmt='%.9f')
    told = PoseSource(file=poses, clock_offset=0.0, accuracy=_MOCAP)
    return camera.camera, _room(camera, folder, told=told, room_error=0.001)


def _room(camera, folder, **more):
    room = folder / 'room.ply'
    write_mesh(camera.solids, room, 0.1)
    # A length in the scan was measured with a tape.
    return RoomRequest(recordings=(), out=folder, room=room, scale_error=0.001, **more)


def chessboard(effects, seed, folder):
    """Record a chessboard; the focal length is known to 0.1 %."""
    del folder
    wall = Shape(ROOM, (0, 0, 0), (2, 1.2, 1.8), light=0.6, dark=0.4, texture=MOTTLE, period=0.9)
    half, scenes = np.array([5, 4]) * _SQUARE, []
    for distance, yaw, pitch in np.array(_BOARDS):
        turned = {'yaw': math.radians(yaw), 'pitch': math.radians(pitch)}
        printed = {'light': 0.8, 'dark': 0.08, 'texture': CHECKER, 'period': _SQUARE}
        board = Shape(BOX, (0.02, -0.01, distance), (*half, 0.002), **printed, **turned)
        paper = Shape(BOX, (0.02, -0.01, distance), (*(half + 0.03), 0.0015), light=0.8, **turned)
        scenes.append(Scene('board', pack([wall, board, paper]), Way((0, 0, 0))))
    named = f'chessboard:9x7:{_SQUARE}'
    request = BoardRequest(recordings=(), out=Path(), board=named, lens_error=0.001)
    return _camera(effects, seed, scenes, 224, 172), request


def corners(effects, seed, folder):
    """Record corners with right angles, whose distances a tape gives."""
    half, scenes = np.array([2.3, 1.35, 2.6]), []
    looks = {'light': 0.7, 'dark': 0.4, 'texture': MOTTLE, 'period': 0.9}
    room = pack([Shape(ROOM, (0, 0, 0), tuple(half), **looks)])
    for (turn, tilt, roll), (left, right, floor) in VIEWS:
        yaw, pitch, turned = np.radians([45 - turn, tilt, -roll])
        place = half - (right, floor, left)
        scenes.append(Scene('corner', room, Way(tuple(place), yaw=yaw, pitch=pitch, roll=turned)))
    planes = describe(folder / 'planes.yaml', taped=TAPE)
    return _camera(effects, seed, scenes, 112, 86), PlaneRequest(
        recordings=(), out=Path(), planes=planes
    )


def _camera(effects, seed, scenes, width, height):
    key = SceneKey(_MODE, seed, 0.0, width, height, len(scenes), _FRAMES)
    seen = SceneSet(key)
    seen.scenes = tuple(scenes)
    return BlindCamera(Case(key, effects, seed), seen)


KINDS = {one.__name__: one for one in (scan, motion_capture, chessboard, corners)}


def case(kind, effect, number):
    """Diagnose a camera with both kinds of ground truth; return the row of the table."""
    seed = DEVELOPMENT.seed(_FIRST + number)
    row = {'kind': kind, 'effect': effect}
    with scratch_folder() as folder:
        exact, given, made = folder / 'exact', folder / 'given', folder / 'made'
        exact.mkdir()
        given.mkdir()
        camera, request = KINDS[kind]({effect: 1.0} if effect else {}, seed, folder)
        camera.record(exact)
        for i in range(len(camera.scenes.scenes)):
            with np.load(exact / f'{i}.npz') as archive:
                left = set(archive) - {'clean_depth', 'reflectivity'}
                # Planes are described by these names.
                name = f'corner{i}' if kind == 'corners' else str(i)
                np.savez(given / f'{name}.npz', **{key: archive[key] for key in left})
        row['exact'] = _judged(diagnose(exact), effect)
        began = time.process_time()
        try:
            make_truth(replace(request, recordings=(given,), out=made))
            row['truth_s'] = round(time.process_time() - began, 1)
            row['made'] = _judged(diagnose(made), effect)
        except InputError as error:
            row['made'] = {'answer': 'unknown', 'named': [str(error)]}
    return row


def _judged(table, effect):
    names = [one['name'] for one in table['effects']]
    others = [one['name'] for one in table['alternatives']]
    hidden = [one['name'] for one in table['not_decidable']]
    gap = table['gap']
    found = {'verdict': table['verdict'], 'named': names, 'gap': gap['shrink'] if names else 0.0}
    if not effect:
        return {'answer': 'wrong' if names else 'right', **found}
    if names[:1] == [effect]:
        answer = 'right'
    elif effect in names + others:
        answer = 'later'
    elif names or table['verdict'] == 'none':
        answer = 'wrong'
    else:
        answer = 'not decidable' if effect in hidden else 'unknown'
    return {'answer': answer, **found}


def main():
    """Print a line for each camera, and the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    known = ','.join(sorted({*CATALOGUE} - {'pose_error'}))  # Poses are what is fitted.
    parser.add_argument('--effects', default=known, help='- for none, after a =')
    parser.add_argument('--kinds', default=','.join(KINDS))
    arguments = parser.parse_args()
    rows = []
    order = sorted(CATALOGUE)
    for place, effect in enumerate(arguments.effects.split(',')):
        number = order.index(effect) if effect in order else place  # The seed.
        for kind in arguments.kinds.split(','):
            if effect in _NEED_MOTION and kind != 'motion_capture':
                continue
            rows.append(case(kind, effect.strip('-'), number))
            print(json.dumps(rows[-1]), flush=True)
    print(_table(rows))


def _table(rows):
    lines = [
        '| ground truth | cameras | with exact truth right | of these with it: right | '
        'later | not decidable | unknown | wrong | s |',
        '|---|' + '---:|' * 8,
    ]
    for kind in KINDS:
        own = [row for row in rows if row['kind'] == kind]
        kept = [row['made']['answer'] for row in own if row['exact']['answer'] == 'right']
        counts = ' | '.join(str(kept.count(answer)) for answer in _EXPECTED)
        seconds = np.mean([row.get('truth_s', 0) for row in own]) if own else 0
        lines.append(f'| {kind} | {len(own)} | {len(kept)} | {counts} | {seconds:.0f} |')
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return '\n'.join([*lines, f'largest memory {used:.0f} MB'])


if __name__ == '__main__':
    main()
