"""Transforms between two frames in the TF of a bag, of one robot only."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from flexx2_sim_ros.errors import InputError, shown, shown_path
from flexx2_sim_ros.messages.decoding import stamp_nanoseconds
from flexx2_sim_ros.recording import bag_messages
from flexx2_sim_ros.recording.bag_files import Bag
import numpy as np

TF = 'tf2_msgs/msg/TFMessage'
_STATIC = 'tf_static'
_FASTEST = 10.0  # metres a second: faster than any robot with a depth camera
_SHORTEST_JUMP = 0.1  # metres: corrections of odometry are smaller, mostly
_MOST_JUMPS = 0.05  # of the steps: corrections are rare, poses of two robots take turns
FARTHEST = 200.0  # metres from the origin; larger values are millimetres
_SAME = 1e-6  # metres and quaternion: rounding


@dataclass
class FrameTransforms:
    """The transforms of one frame, `child` in its `parent`."""

    child: str
    parent: str
    stamps: list[int] = field(default_factory=list)  # nanoseconds
    rows: list[list[float]] = field(default_factory=list)  # x, y, z, qx, qy, qz, qw, one a stamp
    fixed: bool = False  # it was on ``tf_static``


_Tree = dict[str, dict[str, FrameTransforms]]  # by child, then by parent


def transforms_between(
    bag: Bag, parent: str, child: str, camera: str = ''
) -> list[FrameTransforms]:
    """
    Return the transforms from a frame to one under it.

    Frames of topics in different namespaces (``/robot1/tf``, ``/robot2/tf``) may have the same
    names and are never mixed: where several have these frames, the namespace of the camera is
    used. Raises `InputError` where there are none, or they are of several robots.
    """
    trees, name, frames = _read(bag), shown_path(bag.path), f'{shown(parent)},{shown(child)}'
    # In the namespaces around the camera, the nearest first; else in the only one that has them.
    around = [space for space in trees if f'/{camera}/'.startswith(f'{space}/')]
    for space in sorted(around, key=len, reverse=True):
        found = {space: _chain_from(trees, space, parent, child)}
        if found[space] or child in trees[space]:
            break
    else:
        found = {space: _chain_from(trees, space, parent, child) for space in trees}
    there = [space for space, links in found.items() if links]
    if len(there) > 1:
        raise InputError(
            f'--tf: must be frames of one robot, got {frames}, which '
            f'{listed([f"{one}/tf" for one in there])} of {name} have each, and the camera '
            f'{shown(camera)} is in none of these namespaces'
        )
    if not there:
        links = [link for tree in trees.values() for link in tree.items()]
        every = {one for child, parents in links for one in (child, *parents)}
        raise InputError(
            f'--tf: must be two frames of {name}, the second under the first, got {frames}; it '
            f'has {listed(every)}'
        )
    for link in found[there[0]]:
        _check(link, name)
    return found[there[0]]


def _chain_from(
    trees: Mapping[str, _Tree], space: str, parent: str, child: str
) -> list[FrameTransforms]:
    # In one namespace, or also in those around it, if no frame is in two of them.
    links = _chain(trees[space], parent, child)
    if links:
        return links
    parts = [tree for other, tree in trees.items() if f'{space}/'.startswith(f'{other}/')]
    frames = [frame for tree in parts for frame in tree]
    if len(frames) > len(set(frames)):
        return []
    return _chain({k: v for tree in parts for k, v in tree.items()}, parent, child)


def _read(bag: Bag) -> dict[str, _Tree]:
    # By the namespace of the topic.
    trees: dict[str, _Tree] = {}
    topics = {topic for topic, kind in bag.topics.items() if kind == TF}
    for topic, _, _, data in bag.messages(topics):
        space, _, last = topic.rpartition('/')
        tree = trees.setdefault(space, {})
        for one in bag_messages.decode(TF, data, f'{shown_path(bag.path)}: {topic}').transforms:
            child, parent = one.child_frame_id.lstrip('/'), one.header.frame_id.lstrip('/')
            link = tree.setdefault(child, {}).setdefault(parent, FrameTransforms(child, parent))
            link.stamps.append(stamp_nanoseconds(one.header.stamp))
            link.rows.append(pose_of(one.transform.translation, one.transform.rotation))
            link.fixed |= last == _STATIC
    return trees


def _chain(
    tree: Mapping[str, Mapping[str, FrameTransforms]], parent: str, child: str
) -> list[FrameTransforms]:
    # The links from the parent to the child; none if there are none.
    links: list[FrameTransforms] = []
    name = child
    while name != parent and name in tree and len(links) <= len(tree):
        above = tree[name]
        if len(above) > 1:
            raise InputError(
                f'--tf: {shown(name)}: must have one parent, got {listed(above)}: transforms of '
                'two robots with the same frames?'
            )
        links.append(next(iter(above.values())))
        name = links[-1].parent
    return links[::-1] if name == parent else []


def _check(link: FrameTransforms, name: str) -> None:
    # Transforms of two robots on one topic: the frame is in two places at once.
    order = np.argsort(link.stamps, kind='stable')
    poses, stamps = np.array(link.rows)[order], np.array(link.stamps, np.int64)[order]
    good = np.isfinite(poses).all(axis=1)
    poses, stamps = poses[good], stamps[good]
    if (np.abs(poses[:, :3]) > FARTHEST).any():
        return  # millimetres, which are refused elsewhere
    if link.fixed:
        two = len(poses) > 1 and bool((np.ptp(poses, axis=0) > _SAME).any())
    else:
        steps = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
        fast = steps > _FASTEST * np.diff(stamps) / 1e9
        two = bool((fast & (steps > _SHORTEST_JUMP)).sum() > _MOST_JUMPS * len(steps))
    if two:
        raise InputError(
            f'{name}: tf of {shown(link.child)}: must be at one place at a time, got poses that '
            f'{"differ" if link.fixed else "jump to and fro"}: those of two robots with the same '
            'frames?'
        )


def listed(names: Collection[str]) -> str:
    """Return names as words, each once."""
    return shown(', '.join(sorted(set(names)))) if names else 'none'


def pose_of(place: Any, turn: Any) -> list[float]:
    """Return x, y, z, qx, qy, qz, qw."""
    return [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w]
