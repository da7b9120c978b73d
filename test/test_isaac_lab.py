"""
The observation term against the released source of Isaac Lab, which has to be installed.

Isaac Lab itself needs a GPU. Its source is read: the calls that its managers make are bound to the
term's signatures, and its base class of terms and its checks are compiled from it and run.
"""

import abc
import ast
from collections.abc import Callable, Iterable, Mapping, Sequence, Sized
import copy
import enum
import importlib.util
import inspect
import json
from pathlib import Path
import runpy
from types import SimpleNamespace
from typing import Any

from flexx2_sim_ros.batch import noisy_depth
import numpy as np
import pytest

FOUND = importlib.util.find_spec('isaaclab')
if FOUND is None or FOUND.origin is None:
    pytest.skip("could not import 'isaaclab'", allow_module_level=True)
INSTALLED = Path(FOUND.origin).parent
# Isaac Lab 2.3 has its packages in a folder `source`.
ROOT = next(one for one in (INSTALLED / 'source/isaaclab/isaaclab', INSTALLED) if one.is_dir())
CLEAN = np.full((2, 24, 32, 1), 1.2, np.float32)
CAMERA = {'mode': 'Mode_5_30fps', 'K': [[30.0, 0, 15.5], [0, 30.0, 11.5], [0, 0, 1]]}


def parsed(path):
    """Return all nodes of a file of Isaac Lab."""
    return list(ast.walk(ast.parse((ROOT / path).read_text())))


def calls(path, function):
    """Return the calls of a function that a file makes, by the function's text."""
    return [
        node
        for node in parsed(path)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == function
    ]


class TermCfg(SimpleNamespace):
    """A configuration of a term: what it calls, and with what parameters."""


def compiled(path, *names, **space):
    """Compile classes and functions of a file of Isaac Lab alone, without its other modules."""
    wanted = [
        node
        for node in ast.parse((ROOT / path).read_text()).body
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name in names
    ]
    future = ast.parse('from __future__ import annotations').body
    module = ast.fix_missing_locations(ast.Module([*future, *wanted], type_ignores=[]))
    exec(compile(module, path, 'exec'), space)  # noqa: S102 (the released source)
    return space


IMPORTED = {'ABC': abc.ABC, 'Any': Any, 'Callable': Callable, 'Sequence': Sequence}
IMPORTED |= {'ManagerTermBaseCfg': TermCfg, 'copy': copy, 'inspect': inspect}
NAMES = 'ManagerTermBase', '_populate_term_defaults'
SPACE = compiled('managers/manager_base.py', *NAMES, **IMPORTED)
TERM = noisy_depth(SPACE['ManagerTermBase'])


def image_of(env):
    """Return clean depth. Isaac Lab 3 reads no lambda that has an attribute."""
    return env.image


PARAMS = {'depth': image_of, 'camera': CAMERA}


@pytest.mark.parametrize('given', [PARAMS, {'depth': image_of}], ids=['camera', 'no camera'])
def test_the_term_is_made_called_and_reset(given):
    env = SimpleNamespace(num_envs=2, device='cpu', image=CLEAN)
    cfg = TermCfg(func=TERM, params=dict(given))
    if '_populate_term_defaults' in SPACE:  # of Isaac Lab 3, before it makes the term
        SPACE['_populate_term_defaults'](TERM, cfg.params)
    term = TERM(cfg=cfg, env=env)
    assert isinstance(term, SPACE['ManagerTermBase'])
    assert term.num_envs == 2
    seen = term(env, **cfg.params)
    assert seen.shape == CLEAN.shape
    assert 1.1 < np.median(seen) < 1.3
    for chosen in (None, [1], slice(None)):
        term.reset(env_ids=chosen)


def test_a_configuration_survives_its_round_trip():
    """Train scripts write it as text for Hydra and read it: a class becomes its module's name."""
    imported = {'Enum': enum.Enum, 'Iterable': Iterable, 'Mapping': Mapping, 'Sized': Sized}
    imported |= runpy.run_path(str(ROOT / 'utils/string.py'))
    imported['torch'] = SimpleNamespace(Tensor=np.ndarray)
    space = compiled('utils/dict.py', 'class_to_dict', 'update_class_from_dict', **imported)
    cfg = SimpleNamespace(front=TermCfg(func=TERM, params=dict(PARAMS)))
    text = json.dumps(space['class_to_dict'](cfg))
    space['update_class_from_dict'](cfg, json.loads(text))
    env = SimpleNamespace(num_envs=2, device='cpu', image=CLEAN)
    term = cfg.front.func(cfg=cfg.front, env=env)
    assert type(term) is TERM
    assert cfg.front.params['camera'] == CAMERA
    assert term(env, **cfg.front.params).shape == CLEAN.shape


def test_managers_make_and_reset_the_term_as_we_expect():
    (made,) = calls('managers/manager_base.py', 'term_cfg.func')
    assert not made.args
    inspect.signature(TERM).bind(**{word.arg: None for word in made.keywords})
    resets = calls('managers/observation_manager.py', 'term_cfg.func.reset')
    assert resets
    for call in resets:
        assert not call.args
        inspect.signature(TERM.reset).bind(None, **{word.arg: None for word in call.keywords})


def test_managers_call_the_term_as_we_expect():
    made = calls('managers/observation_manager.py', 'term_cfg.func')
    signature = inspect.signature(TERM.__call__)
    plain = [call for call in made if all(keyword.arg is None for keyword in call.keywords)]
    assert plain
    for call in plain:
        assert [ast.unparse(one) for one in call.args] == ['self._env']
        assert [ast.unparse(one.value) for one in call.keywords] == ['term_cfg.params']
        signature.bind(None, None, **PARAMS)
    # Other calls ask for `inspect` or, of terms that have it, for `out`.
    others = {word.arg for call in made if call not in plain for word in call.keywords}
    assert others - {None} <= {'inspect', 'out'}
    assert 'out' not in signature.parameters


def test_cameras_give_what_the_documentation_says():
    """`distance_to_image_plane` is planar; Isaac Lab 3 wraps it, and `.torch` is the tensor."""
    nodes = parsed('sensors/camera/camera_data.py')
    (kind,) = {
        ast.unparse(node.returns if isinstance(node, ast.FunctionDef) else node.annotation)
        for node in nodes
        if (isinstance(node, ast.FunctionDef) and node.name == 'output')
        or (isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == 'output')
    }
    wrapped = 'ProxyArray' in kind
    assert wrapped or 'torch.Tensor' in kind
    if wrapped:
        properties = {
            node.name
            for node in parsed('utils/warp/proxy_array.py')
            if isinstance(node, ast.FunctionDef)
            and 'property' in map(ast.unparse, node.decorator_list)
        }
        assert 'torch' in properties
    text = (ROOT / 'sensors/camera/camera.py').read_text()
    assert '"distance_to_image_plane"``: An image containing distances' in text
    assert "from camera plane along camera's z-axis" in text
