"""Images and their companions find each other by stamp, and never wait long."""

from flexx2_sim_ros.nodes.pairing import StampPairing
from hypothesis import given
from hypothesis import strategies as st
import pytest


def run(pairing, *events):
    """
    Feed events such as ``image 3`` and return what is matched.

    An image comes back with the info's and reflectivity's own names.
    """
    matches = []
    for event in events:
        name, stamp = event.split()
        if name == 'image':
            matches += pairing.image(int(stamp), event)
        else:
            matches += pairing.companion(name, int(stamp), event)
    assert all(match.image == f'image {match.stamp}' for match in matches)
    return [(match.stamp, match.info, match.reflectivity) for match in matches]


def test_an_image_waits_no_longer_than_for_the_next():
    pairing = StampPairing()
    run(pairing, 'info 0', 'image 0', 'reflectivity 0')
    assert run(pairing, 'info 1', 'image 1') == []
    assert run(pairing, 'info 2', 'image 2') == [(1, 'info 1', None), (2, 'info 2', None)]
    assert run(pairing, 'info 3', 'image 3') == [(3, 'info 3', None)]
    assert run(pairing, 'image 4') == []
    assert run(pairing, 'image 5') == [(4, 'info 3', None), (5, 'info 3', None)]
    assert run(pairing, 'image 6') == [(6, 'info 3', None)]


@pytest.mark.parametrize('order', ['info 0, image', 'image, info 0'])
def test_camera_infos_that_keep_the_first_stamp_delay_no_image(order):
    """Assert every image comes out before the next one is sent, as a simulation in steps needs."""
    pairing = StampPairing()
    for stamp in range(20):
        events = order.replace('image', f'image {stamp}').split(', ')
        assert run(pairing, *events) == [(stamp, 'info 0', None)]


def test_a_run_that_starts_again_does_not_see_the_last_ones_companions():
    """Assert stamps that come a second time get what was sent with them the second time."""
    for order in (('image', 'info', 'reflectivity'), ('info', 'reflectivity', 'image')):
        pairing = StampPairing()
        for stamp in range(5):
            pairing.image(stamp, 'old')
            pairing.companion('info', stamp, 'old')
            pairing.companion('reflectivity', stamp, 'old')
        for stamp in range(5):
            assert run(pairing, *(f'{name} {stamp}' for name in order)) == [
                (stamp, f'info {stamp}', f'reflectivity {stamp}')
            ]


EVENTS = st.lists(
    st.tuples(st.sampled_from(['image', 'info', 'reflectivity']), st.integers(0, 30)), max_size=80
)


@given(EVENTS)
def test_any_order_keeps_every_image(events):
    pairing = StampPairing()
    matches = []
    sent = []
    for serial, (name, stamp) in enumerate(events):
        if name == 'image':
            sent.append((stamp, serial))
            matches += pairing.image(stamp, serial)
        else:
            matches += pairing.companion(name, stamp, (stamp, serial))
        assert len(sent) - len(matches) in (0, 1)
    assert [(match.stamp, match.image) for match in matches] == sent[: len(matches)]
    for match in matches:
        assert match.reflectivity is None or match.reflectivity[0] == match.stamp


def test_memory_is_bounded():
    pairing = StampPairing()
    for stamp in range(1000):
        run(pairing, f'info {stamp}', f'reflectivity {stamp}')
    assert run(pairing, 'image 5', 'image 6')[0] == (5, 'info 999', None)
