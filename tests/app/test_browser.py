"""The app in a real browser: from a file to the downloads, faults, cancelling, nothing from elsewhere."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import pytest

import leastaction as la
import page_helpers
from leastaction.app.candidates import Choice
from leastaction.app.columns import ANGLE
from leastaction.app.files import Saved, saved

pytestmark = [pytest.mark.browser, pytest.mark.thorough]

_LAPTOP, _PHONE = (1280, 800), (390, 844)


@pytest.fixture(scope="module")
def chromium() -> str:
    pytest.importorskip("nicegui", reason="the app needs NiceGUI: pip install 'leastaction[app]'")
    pytest.importorskip("playwright", reason="browser tests need Playwright: pip install playwright")
    found = page_helpers.chromium()
    if found is None:
        pytest.skip(
            "no Chromium found; install one (Debian: apt-get install chromium) to run the browser tests"
        )
    return found


@pytest.fixture(scope="module")
def address(chromium: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server of its own, as a user starts it; the address with the token."""
    with page_helpers.running_app(tmp_path_factory.mktemp("server")) as printed:
        yield printed


@dataclass
class Tab:
    """A page of a browser of its own, and everything it has asked for or complained about."""

    page: object
    address: str
    foreign: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def watch(self) -> None:
        base = self.address.partition("?")[0]
        own = (base, base.replace("http:", "ws:"), "data:", "blob:")
        page = self.page
        page.on("request", lambda r: None if r.url.startswith(own) else self.foreign.append(r.url))
        page.on("websocket", lambda w: None if w.url.startswith(own) else self.foreign.append(w.url))
        page.on("pageerror", lambda e: self.complaints.append(str(e)))
        page.on("console", lambda m: self.complaints.append(m.text) if m.type == "error" else None)

    def overflow(self) -> int:
        return self.page.evaluate("document.documentElement.scrollWidth - window.innerWidth")

    def see(self, text: str, seconds: float = 90.0) -> None:
        self.page.get_by_text(text).first.wait_for(timeout=1000 * seconds)

    def click(self, text: str) -> None:
        self.page.get_by_role("button", name=text).first.click()

    def open_example(self, name: str) -> None:
        """Open a measured example; the columns and buttons of the table before it are gone afterwards."""
        self.click(name)
        self.page.get_by_role("heading", name=name, exact=True).wait_for()


@pytest.fixture
def open_tab(chromium: str, address: str, tmp_path: Path):
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        contexts = []

        def start(size: tuple[int, int] = _LAPTOP, scheme: str = "light") -> Tab:
            context = playwright.chromium.launch_persistent_context(
                str(tmp_path / f"profile-{len(contexts)}"),
                executable_path=chromium,
                args=page_helpers.CHROMIUM_OPTIONS,
                viewport={"width": size[0], "height": size[1]},
                color_scheme=scheme,
                accept_downloads=True,
            )
            contexts.append(context)
            tab = Tab(context.pages[0], address)
            tab.watch()
            tab.page.goto(address)
            tab.see("Or a measured example")
            assert tab.page.url == address.partition("?")[0]  # the token does not stay
            tabs.append(tab)
            return tab

        tabs: list[Tab] = []
        yield start
        for context in contexts:
            context.close()
    for tab in tabs:
        assert tab.foreign == []
        assert tab.complaints == []


def test_from_a_file_to_the_downloads(open_tab, tmp_path):
    tab = open_tab()
    page = tab.page
    path = page_helpers.driven_pendulum(tmp_path / "swing (2).csv")
    page.locator("input[type=file]").set_input_files(path)
    tab.see("swing (2).csv")
    tab.see("What was measured")
    page.locator(".figure svg").first.wait_for()
    roles = page.locator(".role .choice")
    chosen = roles.evaluate_all("lists => lists.map((list) => list.selectedOptions[0].text)")
    assert chosen == ["trial", "time (s)", "angle (rad)", "force on theta"]
    tab.click("Continue to the candidates")
    tab.see("Which terms may the Lagrangian contain?")
    page.get_by_text("compact:").click()
    page.get_by_text("viscous, θ").click()
    tab.see("1 for friction; 2 trials fitted, 1 held out")
    tab.click("Find the Lagrangian")
    tab.see("How many terms?")
    tab.see("All checks passed")
    tab.see("Forecast: held-out trials are off by")
    assert page.locator(".formula math").count() == 2
    page.locator(".stick .limbs").first.wait_for()
    with page.expect_download() as report:
        tab.click("report.html")
    with page.expect_download() as model:
        tab.click("model.json")
    text = Path(report.value.path()).read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>")
    assert "swing" in text or "single_pendulum-0" in text
    saved = tmp_path / "model.json"
    model.value.save_as(saved)
    found = la.load(saved)
    assert [term.expression for term in found.terms] == ["theta_dot**2", "cos(theta)"]
    assert found.terms[1].coefficient == pytest.approx(9.81, rel=0.02)
    page.locator("summary", has_text="Export").click()
    with page.expect_download() as code:
        page.get_by_text("Julia module").click()
    assert "function acceleration" in Path(code.value.path()).read_text(encoding="utf-8")
    download = page.get_by_role("button", name="model.json")
    download.evaluate("button => { button.dataset.same = 'yes' }")
    # There and back, so that the law of two terms is saved. A busy machine may delay one of the steps.
    seconds = [page_helpers.seconds_to_the_law_after(page, name) for name in ("More terms", "Fewer terms")]
    assert min(seconds) < 0.3
    assert max(seconds) < 3.0
    # A button that is made anew would lose a click, the focus, or an open list.
    assert download.evaluate("button => button.dataset.same") == "yes"
    with page.expect_download() as session:
        tab.click("Save session")
    session.value.save_as(tmp_path / "mine.leastaction")
    page.reload()
    tab.see("How many terms?")  # a reload loses nothing
    page.locator(".step").first.click()
    page.locator("input[type=file]").set_input_files(tmp_path / "mine.leastaction")
    tab.see("A session does not store the search")
    tab.see("Forecast: held-out trials are off by")
    assert page.locator(".formula math").count() == 2
    page.locator(".step").first.click()
    page.locator("input[type=file]").set_input_files(
        [page_helpers.driven_pendulum(tmp_path / f"run{k}.csv") for k in (2, 10)]
    )
    tab.see("run2.csv and 1 more")
    tab.see("6 trials, 30 s")


def test_what_no_sensor_saw_moves_along_dashed(open_tab, tmp_path):
    """A double pendulum with one encoder; a saved session has the forecast of the other link only."""
    system = la.systems.get("chaotic_pendulum")
    data = la.systems.generate(system, noise=0.002, trials=3, duration=6.0, rate=50.0, seed=3)
    rows = [f"{run.name},{t},{q}" for run in data for t, q in zip(run.t, run.q[:, 0], strict=True)]
    choice = Choice(
        written=True,
        text="\n".join(system.lagrangian),
        known="\n".join(f"{text} = {value}" for text, value in system.known.items()),
        hidden="theta2",
        hidden_angles=True,
        held_out=1,
    )
    tables = {"encoder.csv": "\n".join(["trial,t,theta1", *rows]).encode()}
    tab = open_tab()
    page = tab.page
    content = saved(Saved("encoder.csv", tables, {"theta1": ANGLE}, choice))
    give(tab, tmp_path / "encoder.leastaction", content)
    tab.click("Continue to the candidates")
    tab.click("Find the Lagrangian")
    tab.see("estimated, no sensor", 240.0)
    link = page.locator(".stick .measured .limbs.estimated")
    link.wait_for()
    before = link.get_attribute("d")
    page.wait_for_function(
        "d => document.querySelector('.limbs.estimated').getAttribute('d') !== d", arg=before
    )
    assert page.locator(".stick .measured .limbs").count() == 2
    assert page.locator(".stick .measured circle.estimated").count() == 1
    assert page.locator(".stick .forecast .estimated").count() == 0
    assert "estimated without a sensor dashed" in page.locator(".stick svg").get_attribute("aria-label")
    assert page.locator(".figures desc", has_text="the estimated motion with its 95 % band").count()
    with page.expect_download() as session:
        tab.click("Save session")
    page.locator(".step").first.click()
    give(tab, tmp_path / "again.leastaction", Path(session.value.path()).read_bytes())
    tab.see("a session does not store its estimated motion")
    page.locator(".stick .measured .limbs").wait_for()
    assert page.locator(".stick .measured circle").count() == 1
    assert page.locator(".stick .forecast circle").count() == 2
    assert page.locator(".estimated").count() == 0


def test_a_bad_file_is_one_line_and_the_page_goes_on(open_tab, tmp_path):
    tab = open_tab()
    page = tab.page
    bad = tmp_path / "bad.csv"
    bad.write_text("t,x\n" + "".join(f"{0.1 * k:.1f},{k * k}\n" for k in range(60)) + "6.0,oops\n")
    page.locator("input[type=file]").set_input_files(bad)
    tab.see("bad.csv, line 62, column 'x': 'oops' is not a number")
    assert page.locator(".fault").count() == 1
    assert "Traceback" not in page.content()
    assert page.locator(".step").nth(1).is_disabled()
    nothing = tmp_path / "nothing.csv"
    nothing.write_bytes(b"\x89PNG\0\0\0")
    page.locator("input[type=file]").set_input_files(nothing)
    tab.see("holds binary data, not text")
    tab.open_example("Single pendulum")
    tab.see("What was measured")
    assert page.locator(".fault").count() == 0


@pytest.mark.thorough
def test_a_cancelled_run_leaves_the_app_usable(open_tab):
    tab = open_tab()
    page = tab.page
    tab.open_example("Double pendulum")
    tab.click("Continue to the candidates")
    tab.click("Find the Lagrangian")
    tab.see("Preparing")
    began = time.monotonic()
    page.get_by_role("button", name="Cancel").click()
    tab.see("Data and candidates are unchanged")
    assert time.monotonic() - began < 5.0
    tab.click("Back to the candidates")
    tab.see("16 candidates, 5 for friction; 18 trials fitted, 8 held out")
    page.locator(".step").first.click()
    tab.open_example("Single pendulum")
    tab.click("Continue to the candidates")
    tab.click("Find the Lagrangian")
    tab.see("How many terms?")
    # Along the trade-off curve; a refit can be cancelled too.
    before = page.locator(".formula").all_inner_texts()
    page.get_by_role("button", name="Fewer terms").click()
    tab.see("The criterion prefers the chosen structure by")
    tab.see("taken from the trade-off curve by hand")
    tab.see("Simulated for")
    page.wait_for_function("before => document.querySelector('.formula').innerText !== before", arg=before[0])
    fewer = page.locator(".formula").all_inner_texts()
    assert fewer != before
    page.get_by_role("button", name="More terms").click()
    tab.see("This is the structure that leastaction chose")
    assert page.locator(".formula").all_inner_texts() == before


def test_what_is_typed_is_checked_and_never_run(open_tab):
    tab = open_tab()
    page = tab.page
    tab.open_example("Single pendulum")
    tab.click("Continue to the candidates")
    area = page.get_by_label("Candidates, one expression a line")
    area.fill("theta_dot**2\ncos(thet)\n<img src=x onerror=document.title='run'>\n__import__('os').abort()")
    tab.see("line 2: cannot read 'cos(thet)' at column 5: unknown name 'thet'; did you mean 'theta'?")
    tab.see("3 lines among the candidates cannot be read")
    assert page.get_by_role("button", name="Find the Lagrangian").is_disabled()
    assert page.title() == "leastaction"
    area.fill("theta_dot**2\ncos(theta)")
    tab.see("2 expressions, all readable")
    page.get_by_label("Known coefficients").fill("")
    tab.see("so that L = 0 solves every equation")
    page.get_by_label("Known coefficients").fill("theta_dot**2 = much")
    tab.see("'much' is not a finite number")
    page.get_by_label("Known coefficients").fill("theta_dot**2 = 1")
    tab.see("2 candidates, 2 for friction")
    assert page.get_by_role("button", name="Find the Lagrangian").is_enabled()


@pytest.mark.parametrize(("size", "scheme"), [(_LAPTOP, "dark"), (_PHONE, "light")])
def test_every_screen_fits_its_window(open_tab, size, scheme):
    tab = open_tab(size, scheme)
    page = tab.page
    assert tab.overflow() <= 0
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(20, 23, 26)"
    assert dark == (scheme == "dark")
    tab.open_example("Single pendulum")
    page.locator(".figure svg").first.wait_for(state="attached")
    assert tab.overflow() <= 0
    # Of the two shapes of a figure one is seen.
    assert page.locator(".figure .wide").first.is_visible() == (size == _LAPTOP)
    assert page.locator(".figure .narrow").first.is_visible() == (size == _PHONE)
    tab.click("Continue to the candidates")
    page.get_by_text("Generated").click()
    tab.see("The candidates as formulas")
    page.get_by_text("The candidates as formulas").click()
    page.locator(".term math").first.wait_for()
    assert tab.overflow() <= 0
    tab.click("Find the Lagrangian")
    tab.see("How many terms?")
    page.locator(".stick .limbs").first.wait_for()
    assert tab.overflow() <= 0


def test_a_link_of_another_site_opens_the_app_if_the_browser_has_been_let_in(open_tab, address):
    tab = open_tab()
    home = address.partition("?")[0]
    elsewhere = home.replace("127.0.0.1", "localhost") + "elsewhere"  # another site, as browsers count
    tab.page.route(
        elsewhere, lambda route: route.fulfill(body=f'<a href="{home}">go</a>', content_type="text/html")
    )
    tab.page.goto(elsewhere)
    tab.page.get_by_text("go").click()
    tab.see("Or a measured example")
    assert tab.page.url == home
    assert tab.foreign == [elsewhere]
    tab.foreign.clear()
    # the first answer of the two, without the cookie
    assert [text for text in tab.complaints if "403" not in text] == []
    tab.complaints.clear()


def test_the_server_answers_to_this_computer_only(address):
    cookie = page_helpers.cookie_for(address)
    _, headers, page = page_helpers.ask(address.partition("?")[0], cookie=cookie)
    policy = headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "http" not in policy
    assert "<html" in page
    assert "https://" not in page
    assert page_helpers.ask(address, host="evil.example")[0] == 400
    assert page_helpers.ask(address, "POST", content_length="999999999")[0] == 413
    port = urlsplit(address).port
    others = [info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)]
    for host in {host for host in others if not host.startswith("127.")}:
        with pytest.raises(OSError, match=r"."):
            socket.create_connection((host, port), timeout=2).close()


def test_a_browser_that_leaves_before_its_answer_is_no_fault(address):
    # what the server logs is looked at when it ends
    place, cookie = urlsplit(address), page_helpers.cookie_for(address)
    home = f"http://{place.netloc}/"
    (script, *_) = re.findall(r'src="(/[^"]+)"', page_helpers.ask(home, cookie=cookie)[2])
    for _ in range(50):
        with socket.create_connection((place.hostname, place.port)) as connection:
            lines = f"GET {script} HTTP/1.1", f"Host: {place.netloc}", f"Cookie: {cookie}"
            connection.sendall("\r\n".join([*lines, "", ""]).encode())
    assert page_helpers.ask(home, cookie=cookie)[0] == 200


def test_a_port_in_use_is_one_line(address):
    port = str(urlsplit(address).port)
    command = [sys.executable, "-m", "leastaction", "app", "--no-browser", "--port", port]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 2
    assert result.stderr.startswith(f"error: port {port} is in use")
    assert len(result.stderr.splitlines()) == 1


def test_report_and_app_are_painted_at_once(address, tmp_path):
    """Both pages have a policy without ``eval``. The limits of ``first-minute`` need a quiet machine."""
    la.write_report(page_helpers.spring(), tmp_path / "report.html")
    with page_helpers.browser() as browser:
        for page in ((tmp_path / "report.html").as_uri(), address):
            assert 0.0 < min(page_helpers.seconds_to_paint(browser, page) for _ in range(3)) < 3.0


# -------------------------------------------------------------- for everybody: axe-core
def findings_of_axe(page, grave: tuple[str, ...] = ("moderate", "serious", "critical")) -> list[str]:
    """What axe-core finds on a page, with the first element of each kind."""
    source = page_helpers.axe_source()
    if source is None:
        pytest.skip("no axe-core found; npm install axe-core, or pip install axe-playwright-python")
    page.evaluate(source)
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
    return [
        f"{v['impact']} {v['id']}: {v['help']} ({len(v['nodes'])} times): {v['nodes'][0]['html'][:200]}"
        for v in found
        if v["impact"] in grave
    ]


@pytest.mark.parametrize(("size", "scheme"), [(_LAPTOP, "light"), (_PHONE, "dark")])
def test_axe_finds_nothing_serious_in_any_state_of_the_app(open_tab, tmp_path, size, scheme):
    """Every view with everything that opens in it; focus and pointer stay where the last click was."""
    tab = open_tab(size, scheme)
    found: list[str] = []

    def look(state: str) -> None:
        found.extend(f"{state}: {line}" for line in findings_of_axe(tab.page))

    look("empty")
    states_of_the_data(tab, look, tmp_path)
    states_of_the_candidates(tab, look)
    states_of_the_result(tab, look)
    states_of_an_arm(tab, look, tmp_path)
    assert not found, "\n".join(sorted(set(found)))


def give(tab: Tab, path: Path, content: bytes) -> None:
    path.write_bytes(content)
    tab.page.locator("input[type=file]").set_input_files(path)


def states_of_the_data(tab: Tab, look, folder: Path) -> None:
    give(tab, folder / "nothing.csv", b"\x89PNG\0\0\0")
    tab.see("holds binary data, not text")
    look("a file that is refused")
    give(tab, folder / "still.csv", b"t,x\n" + b"".join(b"%g,1\n" % (0.01 * k) for k in range(200)))
    tab.see("What was measured")
    tab.page.locator(".figure svg").first.wait_for(state="attached")
    look("one trial")
    tab.page.locator(".role .choice").nth(1).select_option("not used")
    tab.see("no column is a coordinate yet")
    look("a role is missing")
    tab.page.locator(".role .choice").nth(1).select_option("coordinate")
    tab.see("What was measured")
    tab.click("Continue to the candidates")
    tab.see("Which terms may the Lagrangian contain?")
    tab.click("Find the Lagrangian")
    tab.see("No model")
    look("no model")
    tab.page.locator(".step").first.click()
    tab.open_example("Double pendulum")
    tab.page.locator(".trial .choice").wait_for()
    look("several trials")


def states_of_the_candidates(tab: Tab, look) -> None:
    page = tab.page
    tab.click("Continue to the candidates")
    tab.see("16 candidates, 5 for friction")
    look("written candidates")
    page.get_by_label("Candidates, one expression a line").fill("theta1_dot**2\ncos(thet)")
    tab.see("1 line among the candidates cannot be read")
    look("a fault among the candidates")
    page.get_by_text("Generated").click()
    tab.see("The candidates as formulas")
    for text in ("The candidates as formulas", "Other friction"):
        page.get_by_text(text).click()
    page.locator(".term math").first.wait_for()
    page.wait_for_timeout(500)  # until the folds are open
    look("generated candidates")
    tab.click("Find the Lagrangian")
    tab.see("Terms so far")
    look("searching")
    tab.click("Cancel")
    tab.see("Data and candidates are unchanged")
    look("cancelled")


def states_of_the_result(tab: Tab, look) -> None:
    page = tab.page
    page.locator(".step").first.click()
    tab.open_example("Single pendulum")
    tab.click("Continue to the candidates")
    tab.click("Find the Lagrangian")
    tab.see("How many terms?")
    page.locator(".stick").wait_for()
    look("result")
    # Names are written as in the formulas.
    assert page.locator(".status math").count()
    assert "theta" not in page.locator(".status").first.inner_text()
    page.get_by_text("Worth knowing").click()
    page.wait_for_timeout(500)
    look("notes")
    page.locator("summary", has_text="Export").click()
    tab.see("Julia module")
    box = page.locator(".choices").bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= page.viewport_size["width"]
    look("exports")
    page.keyboard.press("Escape")
    assert not page.get_by_text("Julia module").is_visible()
    tab.click("Keep for comparison")
    tab.see("Kept: the next result")
    tab.click("Fewer terms")
    look("a step along the curve")
    tab.see("Compared with the kept model")
    page.locator(".stick").wait_for()
    look("two models")
    with page.expect_download() as session:
        tab.click("Save session")
    page.locator(".step").first.click()
    content = Path(session.value.path()).read_bytes()
    page.locator("input[type=file]").set_input_files(
        {"name": "mine.leastaction", "mimeType": "application/zip", "buffer": content}
    )
    tab.see("A session does not store the search")
    page.locator(".stick").wait_for()
    look("a saved session")


def states_of_an_arm(tab: Tab, look, folder: Path) -> None:
    tab.page.locator(".step").first.click()
    tab.page.locator("input[type=file]").set_input_files(page_helpers.arm_log(folder))
    tab.see("Identify the arm")
    look("an arm")
    tab.click("Identify the arm")
    tab.see("inverse_dynamics.py")
    assert tab.overflow() == 0
    limbs = tab.page.get_by_role("img", name="Robot arm as measured, x to the right").locator(".limbs")
    limbs.wait_for()
    slider = tab.page.get_by_role("slider", name="Time")
    slider.fill("0")
    before = limbs.get_attribute("d")
    slider.fill("100")
    tab.see("Play")  # who moves the slider stops the animation
    assert limbs.get_attribute("d") != before
    tab.page.frame_locator("iframe").get_by_text("Robot arm two").first.wait_for()
    look("the report on an arm")


def test_axe_finds_nothing_serious_in_a_report(chromium, tmp_path):
    from playwright.sync_api import sync_playwright

    from page_helpers import spring

    la.write_report(spring(friction=0.1), tmp_path / "report.html")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=page_helpers.CHROMIUM_OPTIONS)
        for scheme in ("light", "dark"):
            context = browser.new_context(color_scheme=scheme, bypass_csp=True)
            page = context.new_page()
            page.goto((tmp_path / "report.html").as_uri())
            page.evaluate("document.querySelectorAll('details').forEach((fold) => { fold.open = true; })")
            assert findings_of_axe(page) == []
            page.emulate_media(color_scheme=scheme)
            page.pdf(path=tmp_path / "report.pdf", format="A4")
        browser.close()
    if shutil.which("pdftotext") is None:
        return
    command = ["pdftotext", "-layout", tmp_path / "report.pdf", "-"]
    text = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    lines = [sum(bool(line.strip()) for line in page.splitlines()) for page in text.split("\f")[:-1]]
    assert min(lines) >= 8, f"a page with next to nothing on it: {lines} lines"
