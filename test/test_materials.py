"""Reflectivity of surfaces: by material, else by colour; files of materials."""

from flexx2_sim_ros.errors import InputError
from flexx2_sim_ros.profiles.intrinsics import Intrinsics
from flexx2_sim_ros.rendering.materials import load_materials, reflectivity_table
from flexx2_sim_ros.robots.model import build_model
import mujoco
import numpy as np
import pytest

FLEXX2 = Intrinsics.from_field_of_view(224, 172, 56.0, 44.0)


def test_reflectivity_follows_the_material_and_then_the_colour():
    model = build_model(intrinsics=FLEXX2)
    table = reflectivity_table(model)
    assert (table.shape, table.dtype) == ((model.ngeom + 1,), np.float32)
    materials = load_materials()
    for geom, material in (
        ('scene/board_leaning', 'white_board'), ('scene/pole_black', 'black'),
        ('FR_foot', 'go1_rubber'), ('front_left_housing', 'flexx2_housing'),
    ):  # fmt: skip
        assert table[model.geom(geom).id] == pytest.approx(materials[material])
    assert table[-1] == 0.0
    used = {model.mat(i).name.rsplit('/')[-1] for i in range(model.nmat)}
    assert used <= set(materials)  # no built-in surface is left to a guess


def test_reflectivity_without_a_listed_material_is_the_luminance():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco>
          <asset><material name="moss" rgba="0 1 0 1"/><material name="x/black" rgba="1 1 1 1"/>
          </asset>
          <worldbody>
            <geom size="1" rgba="1 0 0 1"/><geom size="1" material="moss"/>
            <geom size="1" material="moss" rgba="0 0 1 1"/><geom size="1" material="x/black"/>
          </worldbody>
        </mujoco>""")
    np.testing.assert_allclose(
        reflectivity_table(model, {'black': 0.04}), [0.2126, 0.7152, 0.0722, 0.04, 0], atol=1e-6
    )


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('schema: 1', 'materials'),
        ('{schema: 1, materials: [wood]}', 'materials'),
        ('{schema: 1, materials: {wood: 0.5}}', 'materials.wood'),
        ('{schema: 1, materials: {wood: {reflectivity: 1.5}}}', 'materials.wood'),
        ('{schema: 1, materials: {wood: {reflectivity: .nan}}}', 'materials.wood'),
        ('{schema: 1, materials: {wood: {reflectivity: bright}}}', 'materials.wood'),
    ],
)
def test_a_bad_material_file_is_named(tmp_path, text, said):
    path = tmp_path / 'materials.yaml'
    path.write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        load_materials(path)
    assert str(path) in str(caught.value)
