"""The page on recordings, in a real browser."""

from contextlib import contextmanager
import re

from browser import chromium
from flexx2_sim_ros.effects import parse_effects
from flexx2_sim_ros.truth.plane_file import PlaneHint, read_planes
from made_bags import camera_entries, depths, SECOND, write
import numpy as np
import pytest
from views import COUNT, EFFECTS, save_diagnosis, save_walk, serve_files, SIZE, View

NUMBER = "document.querySelector('[data-part=number]').textContent"


@pytest.fixture(scope='module')
def browser(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp('browser')) as browser:
        browser.resize()
        yield browser


@pytest.fixture(scope='module')
def page(browser, tmp_path_factory):
    """Open a folder with two recordings, and a bag whose second camera starts two frames later."""
    folder = tmp_path_factory.mktemp('view')
    (folder / 'campaign').mkdir()
    save_walk(folder / 'campaign' / 'a.npz')
    save_walk(folder / 'campaign' / 'b.npz')
    entries = [
        entry
        for name, start in (('left', SECOND), ('right', SECOND + 2 * (SECOND // 60)))
        for entry in camera_entries(name, depths(6, 8, 9), depths(6, 8, 9), start)
    ]
    write(folder / 'campaign' / 'c', sorted(entries, key=lambda entry: entry[2]))
    with serve_files(folder / 'campaign') as url, shown(browser, url):
        yield browser


@contextmanager
def shown(browser, url):
    """Open a page, which may not complain."""
    browser.open(url)
    browser.until(f'{NUMBER} === "1 / {COUNT}"')
    yield
    assert browser.said('Runtime.exceptionThrown') == []
    assert browser.said('Log.entryAdded') == []


def press(page, code, key=''):
    page.evaluate('document.activeElement.blur()')
    page.press(code, key)


def test_keys_move_and_play_a_recording(page):
    for code, number in (
        ('End', COUNT),
        ('ArrowLeft', COUNT - 1),
        ('Home', 1),
        ('ArrowRight', 2),
        ('ArrowRight', 3),
    ):
        press(page, code)
        page.until(f'{NUMBER} === "{number} / {COUNT}"')
    assert page.evaluate('document.getElementById("time-slider").value') == '2'
    action = 'document.getElementById("play").dataset.action'
    # Slowly, since a busy machine asks late.
    page.enter('document.getElementById("rate")', '0.1', 'change')
    press(page, 'Space', ' ')
    assert page.evaluate(action) == 'pause'
    # It ends at the last frame, and begins again from the first.
    page.until(f'{action} === "play"')
    page.until(f'{NUMBER} === "{COUNT} / {COUNT}"')
    press(page, 'Space', ' ')
    press(page, 'Space', ' ')
    assert page.evaluate(action) == 'play'
    assert page.evaluate('Number(document.getElementById("time-slider").value)') < COUNT - 1


def test_every_control_is_reached_with_tab_and_shows_it(page):
    page.evaluate('document.activeElement.blur(); window.scrollTo(0, 0)')
    reached = []
    for _ in range(13):
        page.key('keyDown', 'Tab', 'Tab', windowsVirtualKeyCode=9)
        name, style = page.evaluate(
            '(() => { const on = document.activeElement;'
            'return [on.id || on.dataset.part || "", getComputedStyle(on).outlineStyle]; })()'
        )
        reached.append(name)
        assert not name or style == 'solid', name
    wanted = ['depth-range', 'difference-range', 'wipe', 'mark', 'recording', 'choice']
    wanted += ['earlier', 'play', 'later', 'time-slider', 'rate']
    start = reached.index('depth-range')
    assert reached[start : start + len(wanted)] == wanted


def test_depth_is_compared_with_what_is_chosen(page):
    choice = "document.querySelector('[data-part=choice]')"
    offset = "document.querySelector('[data-part=difference-numbers]').textContent"
    names = page.evaluate(f'[...{choice}.options].map((option) => option.value)')
    assert names == ['clean', 'simulated']

    def choose(name):
        page.enter(choice, name, 'change')
        page.evaluate('document.querySelector("[data-part=difference-numbers]").textContent = ""')
        page.until(offset)
        return numbers(page, 'difference')[0]

    press(page, 'Home')
    page.until(f'{NUMBER} === "1 / {COUNT}"')
    # At 2 m sigma_z is 7 mm at most: the median of 2000 pixels is off by 1 mm with less than 1e-6.
    assert abs(choose('clean')) < 1.5
    assert abs(choose('simulated')) < 1.5


def numbers(page, kind):
    """Return the millimetres under a difference: median, mean size, from where the worst are."""
    text = page.evaluate(f"document.querySelector('[data-part={kind}-numbers]').textContent")
    return [float(one.replace('−', '-')) for one in re.findall(r'([+−]?[\d.]+)(?=,| mm)', text)]


def test_cameras_of_a_bag_are_shown_at_the_same_time(page):
    recording = 'document.getElementById("recording")'
    page.enter(recording, 2, 'change')
    numbers = '[...document.querySelectorAll("[data-part=number]")].map((one) => one.textContent)'
    page.until(f'{numbers}.join() === "1 / 6,1 / 6"')
    for _ in range(4):
        press(page, 'ArrowRight')
    page.until(f'{numbers}.join() === "5 / 6,3 / 6"')
    page.enter(recording, 0, 'change')
    page.until(f'{NUMBER} === "1 / {COUNT}"')


def test_the_page_of_recordings_fits_a_phone(page):
    page.resize(390, 844)
    widest, bottom = page.evaluate(
        '[document.documentElement.scrollWidth,'
        ' document.getElementById("play").getBoundingClientRect().bottom]'
    )
    page.resize()
    assert widest <= 390
    assert bottom <= 844


def colours(page, part):
    """Return the (H, W, 3) colours of an image."""
    data = page.evaluate(f"[...document.querySelector('[data-part={part}]').surface.image.data]")
    return np.array(data, np.uint8).reshape(*SIZE, 4)[..., :3]


def test_a_recording_is_played_beside_both_simulations(browser, tmp_path):
    (tmp_path / 'campaign').mkdir()
    save_walk(tmp_path / 'campaign' / 'a.npz')
    diagnosis, page = save_diagnosis(tmp_path / 'diagnosis'), browser
    with serve_files(diagnosis, tmp_path / 'campaign') as url, shown(page, url):
        page.until('document.querySelector(".paired") !== null')
        images = page.evaluate(
            "[...document.querySelectorAll('figure')].filter((one) => one.offsetWidth)"
            '.map((one) => [one.offsetTop, one.offsetLeft, one.firstChild.dataset.part])'
            '.sort((a, b) => a[0] - b[0] || a[1] - b[1]).map((one) => one[2])'
        )
        assert images == ['simulated', 'without', 'clean', 'cloud', 'gap', 'difference']
        assert page.evaluate(
            'document.getElementById("time").getBoundingClientRect().top >='
            ' document.querySelector(".camera").getBoundingClientRect().bottom'
        )
        # The recording has no offset; the simulation with the effects of the diagnosis has one.
        bias = 1000 * parse_effects(EFFECTS)[0].bias
        without, with_effects = numbers(page, 'gap'), numbers(page, 'difference')
        assert without[0] - with_effects[0] == pytest.approx(bias, abs=2)
        assert without[2] > 2 * without[1] > 0
        green = (colours(page, 'gap') == (0, 158, 115)).all(axis=2)
        assert 0.01 <= green.sum() / (SIZE[0] * (SIZE[1] - 4)) < 0.015
        recorded = colours(page, 'simulated')
        assert (colours(page, 'without') != recorded).any(axis=2).mean() > 0.02
        page.evaluate("document.getElementById('mark').focus()")
        page.press('Space', ' ', text=' ')
        page.evaluate("document.getElementById('wipe').focus()")
        page.press('End', windowsVirtualKeyCode=35)
        page.evaluate('new Promise(requestAnimationFrame)')
        assert not (colours(page, 'gap') == (0, 158, 115)).all(axis=2).any()
        assert page.evaluate("document.getElementById('play').dataset.action") == 'play'
        for kind in ('without', 'clean'):
            np.testing.assert_array_equal(colours(page, kind), recorded)
        # The line can uncover a simulation, too: here in the whole width of both other images.
        page.enter("document.querySelector('[data-part=uncovered]')", 'without', 'change')
        page.evaluate('new Promise(requestAnimationFrame)')
        simulated = colours(page, 'without')
        assert (simulated != recorded).any(axis=2).mean() > 0.02
        for kind in ('simulated', 'clean'):
            np.testing.assert_array_equal(colours(page, kind), simulated)
        # The shade of invalid pixels in the wiped images agrees with the number under them.
        gray = (simulated == (62, 66, 74)).all(axis=2).mean()
        text = page.evaluate("document.querySelector('[data-part=gap-numbers]').textContent")
        assert text.endswith(f'; {100 * gray:.1f} % invalid')


PLANES = """\
schema: 1
planes:
- name: left  # a wall
recordings:
  a:
    left: {distance: ___, box: ___}  # measure it
"""


def test_outlines_are_drawn_with_pointer_and_keys(browser, tmp_path):
    save_walk(tmp_path / 'a.npz')
    planes, page = tmp_path / 'planes.yaml', browser
    planes.write_text(PLANES)
    words = str(tmp_path / 'a.npz'), '--planes', str(planes)
    with View(tmp_path, *words) as view, shown(page, view.url):
        state = "document.querySelector('[data-part=region-state]').textContent"
        canvas = "document.querySelector('[data-part=outline]')"
        page.evaluate(f'{canvas}.scrollIntoView()')
        left, top, width, height = page.box(canvas)
        for count, (u, v) in enumerate([(6, 5), (40, 5), (40, 30)], 1):
            place = {
                'x': left + (u + 0.5) * width / SIZE[1],
                'y': top + (v + 0.5) * height / SIZE[0],
            }
            for kind in ('mousePressed', 'mouseReleased'):
                page.call(
                    'Input.dispatchMouseEvent', type=kind, button='left', clickCount=1, **place
                )
            page.until(f'{state}.startsWith("{count} corner")')
        page.evaluate(f'{canvas}.focus()')
        for code in ('ArrowLeft', 'ArrowLeft', 'ArrowDown', 'Enter', 'Enter', 'Backspace', 'KeyS'):
            page.press(code)
        page.until(f'{state} === "4 corners: saved as left"')
        # The keys were not those of the player.
        assert page.evaluate(NUMBER) == f'1 / {COUNT}'
        corners = (6, 5), (40, 5), (40, 30), (38, 31)
        assert read_planes(planes).changes['a']['left'] == PlaneHint('left', outline=corners)
        assert planes.read_text() == PLANES.replace(
            'box: ___', f'outline: {[list(corner) for corner in corners]}'
        )
        name = "document.querySelector('[data-part=plane]')"
        for value, said in (('', '0 corners'), ('left', '4 corners: saved')):
            page.enter(name, value)
            assert page.evaluate(state) == said
        page.evaluate(f'{name}.value = ""; document.querySelector("[data-part=save]").click()')
        assert page.evaluate(state) == '4 corners: give the plane a name'
        assert view.end() == 130
        assert view.errors == ''
