"""What page.js adds to viser's page, in a real browser: address, theme, connection, keys of sliders."""

from browsing import COARSE, opened_page, serving_here, slider, tab

from fdcal.model.scene_file import load_scene


def test_the_page_follows_address_and_theme_and_comes_back_with_the_server(browser, kernels):
    scene = load_scene("tiny")
    with serving_here(scene) as url:
        page = opened_page(browser, url, f"{COARSE}&microphone=5&modes=2-4&map=none")
        page.wait_for_function("location.hash.includes('scene=tiny&microphone=5&modes=2-4&map=none')")
        page.emulate_media(color_scheme="dark")
        page.locator("html[data-mantine-color-scheme=dark]").wait_for()
        page.evaluate("location.hash = 'microphone=7&map=none'")
        page.wait_for_function("location.hash.includes('microphone=7')")
        tab(page, "Map")
        handle = slider(page, "Microphone")
        handle.focus()
        place = "window.__viserMutable.camera.position.toArray().join()"
        before = page.evaluate(place)
        handle.press("ArrowRight", delay=300)
        page.wait_for_function("location.hash.includes('microphone=8')")
        assert page.evaluate(place) == before, "the arrows move the slider alone"
        page.goto("about:blank")  # away, while another browser goes on
        other = opened_page(browser, url, f"{COARSE}&microphone=3&map=none")
        other.wait_for_function("location.hash.includes('microphone=3')")
        page.go_back()
        page.wait_for_function("location.hash.includes('microphone=3')")
        other.wait_for_timeout(500)
        assert "microphone=3" in other.evaluate("location.hash"), "who comes back leaves the session as it is"
        other.evaluate("location.hash = 'microphone=8&map=none&scene=t%69ny'")
        page.wait_for_function("location.hash.includes('microphone=8')")
        other.close()
    page.get_by_text("The connection is lost").wait_for()
    page.wait_for_timeout(3000)  # in which viser alone would make Chromium delay its attempts
    with serving_here(scene, port=int(url.rpartition(":")[2])):
        page.get_by_text("The connection was lost and is back").wait_for()
        page.wait_for_function("location.hash.includes('microphone=8')")
        tab(page, "Map")
        assert slider(page, "Microphone").get_attribute("aria-valuenow") == "8"
        page.close()
