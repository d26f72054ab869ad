"""The page of a report in a real browser, Debian's Chromium: what it draws, how it sorts, that no name does anything.

Screenshots are left in build/screenshots. Without Chromium or playwright these tests are skipped, unless
FIBERCONTACT_REQUIRE_CHROMIUM is set.
"""

import os
import shutil
from pathlib import Path

import pytest
from report_rows import PROBLEMS, RUNS, SOLVERS, page_of_core306, rods_of_ours, row, rows, write_run

from fibercontact.bench.html_report.figures import Curve
from fibercontact.bench.html_report.page import Shown, write_page
from fibercontact.bench.html_report.portraits import Portrait
from fibercontact.bench.html_report.rods import Rods
from fibercontact.bench.html_report.runs import reported
from fibercontact.bench.report import number

ROOT = Path(__file__).parents[1]
SHOTS = ROOT / "build" / "screenshots"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
ARGUMENTS = [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]  # WebGL without a GPU

HOSTILE = [
    "</script><script>document.title='pwned'</script>",
    '"><img src=x onerror="document.title=\'pwned\'">',
    "{{7*7}}{%raw%}",
    "<a href=\"javascript:document.title='pwned'\">x</a>",
    "<!--<script>",
    "%{x}<extra>&lt;b&gt;</extra>",
    "__proto__",
]

try:
    from playwright.sync_api import sync_playwright
except ImportError:
    sync_playwright = None

if not os.environ.get("FIBERCONTACT_REQUIRE_CHROMIUM"):
    if CHROMIUM is None:
        pytest.skip("no chromium on the path (Debian: apt-get install chromium)", allow_module_level=True)
    if sync_playwright is None:
        pytest.skip(
            "no playwright (pip install playwright; it drives the system's Chromium)", allow_module_level=True
        )


@pytest.fixture(scope="module")
def browser():
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield running
        running.close()


@pytest.fixture
def open_page(browser):
    """Open a file; fails afterwards if the page complained, asked the network for something, or was taken over."""
    opened, complaints = [], []

    def visit(file, **settings):
        page = browser.new_page(**{"viewport": {"width": 1280, "height": 900}} | settings)
        page.set_default_timeout(120_000)
        page.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("dialog", lambda dialog: complaints.append(f"dialog: {dialog.message}"))
        page.on(
            "request",
            lambda asked: (
                None
                if asked.url.startswith((file.as_uri(), "data:", "blob:"))
                else complaints.append(asked.url)
            ),
        )
        page.goto(file.as_uri())
        page.wait_for_selector("#profile .legendtext, #within .legendtext")
        opened.append(page)
        return page

    yield visit
    for page in opened:
        assert page.title() != "pwned"
        page.close()
    assert complaints == []


def curves(names):
    return [Curve(name, [1, 10, 100], [0.5, 0.02 * (k + 1), 0.001 * (k + 1)]) for k, name in enumerate(names)]


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Two runs; of the first a problem is looked at closely."""
    folder = tmp_path_factory.mktemp("page")
    run = reported(write_run(folder / "first", rows() + rows("mid", "rates")))
    other = reported(write_run(folder / "second", rows("mid", "rates", cpu="6502")[:-2], finished=False))
    portrait = Portrait("two", "hash-two", "comb", 300, "mid", curves(SOLVERS), ["a note"], rods_of_ours())
    write_page([Shown(run, [portrait]), Shown(other, [])], folder / "page.html")
    return folder / "page.html"


def texts(page, selector):
    return [text.strip() for text in page.locator(selector).all_inner_texts()]


def column(page, k):
    """Cells of the table of problems in a column."""
    return texts(page, f"#problems tbody tr > :nth-child({k})")


def traces(page, figure):
    return page.evaluate(f"document.getElementById({figure!r}).data.map((trace) => trace.name)")


def shoot(page, name):
    SHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SHOTS / f"{name}.png", full_page=True)


def test_the_table_of_problems_has_the_rows_numbers(file, open_page):
    page = open_page(file)
    head = texts(page, "#problems thead th")
    assert head == ["problem", "scene", "contacts", "μ", *SOLVERS]
    found = {line[0]: line[1:] for line in zip(*(column(page, k + 1) for k in range(len(head))), strict=True)}
    for k, (problem, (scene, contacts, mu)) in enumerate(PROBLEMS.items()):
        cells = [reason or number(ms) for _, ms, reason in (RUNS[name][k] for name in SOLVERS)]
        assert found[problem] == (scene, str(contacts), number(mu), *cells)


def test_the_table_of_problems_sorts_both_ways_and_failures_come_last(file, open_page):
    page = open_page(file)
    page.get_by_role("button", name="hybrid", exact=True).click()
    assert column(page, 6) == ["1", "8", "9", "false success"]
    page.get_by_role("button", name="hybrid", exact=True).click()
    assert column(page, 6) == ["9", "8", "1", "false success"]
    page.get_by_role("button", name="contacts", exact=True).click()
    assert column(page, 1) == ["four", "one", "two", "three"]
    assert page.locator("#problems th[aria-sort=ascending]").inner_text().strip() == "contacts"
    page.locator("#figure").select_option(label="sweeps")
    page.get_by_role("button", name="pac", exact=True).click()
    assert column(page, 5) == ["20", "40", "local", "outer"]


def test_the_table_of_problems_filters(file, open_page):
    page = open_page(file)
    page.locator("#find").fill("TW")
    assert column(page, 1) == ["two"]
    page.locator("#find").fill("")
    page.locator("#scene").select_option(label="wisp")
    assert sorted(column(page, 1)) == ["four", "three"]
    page.locator("#outcome").select_option(label="a false success")
    assert column(page, 1) == ["four"]
    assert page.locator("#count").inner_text() == "1 of 4 problems"
    page.locator("#outcome").select_option(label="every solver failed")
    assert column(page, 1) == []


def test_a_solver_is_switched_off_everywhere_and_on_again(file, open_page):
    page = open_page(file)
    figures = ("profile", "within", "curves")
    assert [traces(page, figure) for figure in figures] == [SOLVERS] * 3
    page.get_by_label("pac", exact=True).uncheck()
    left = ["hybrid", "secular"]
    assert [traces(page, figure) for figure in figures] == [left] * 3
    assert texts(page, ".shown:visible tbody tr:visible th") == left
    assert texts(page, "#problems thead th")[4:] == left
    assert texts(page, "#strata thead th")[2:] == left
    assert page.evaluate("document.getElementById('reasons').data.every((trace) => !trace.y.includes('pac'))")
    page.locator("#outcome").select_option(label="some solver failed")
    assert column(page, 1) == ["four"]  # two was failed by pac alone
    page.get_by_label("pac", exact=True).check()
    assert traces(page, "profile") == SOLVERS
    assert "two" in column(page, 1)


def test_runs_and_accuracies_are_chosen(file, open_page):
    page = open_page(file)
    page.locator("#view").select_option(label="mid (1e-04), rates only")
    assert page.locator("#profile-section").is_hidden()
    assert page.locator(".shown:visible h3").inner_text().startswith("first: 4 problems, accuracy mid")
    page.locator("#run").select_option(label="second")
    assert page.locator(".shown:visible h3").inner_text().startswith("second: 4 problems, accuracy mid")
    assert "not run" in column(page, 6)
    assert page.locator("#no-portrait").is_visible()
    assert page.locator("#closely").is_hidden()
    text = page.locator("main").inner_text()
    assert "second: incomplete: at accuracy mid, 2 of 12 rows are missing (hybrid 1, secular 1)" in text
    assert "6502" in text


def test_a_problem_is_shown_closely(file, open_page):
    page = open_page(file)
    page.locator("#problems").get_by_role("button", name="two", exact=True).click()
    assert page.locator("#portrait-words").inner_text().startswith("comb, 300 contacts")
    assert texts(page, "#portrait-notes li") == ["a note"]
    page.locator("#rods").scroll_into_view_if_needed()
    page.wait_for_selector("#rods canvas")
    assert {"fibres", "obstacle"} <= set(traces(page, "rods"))


def test_no_name_does_anything_but_stand_there(tmp_path, open_page):
    names = dict(zip(PROBLEMS, HOSTILE, strict=False))
    solvers = dict(zip(SOLVERS, HOSTILE[1:4], strict=True))
    machine = {"cpu": HOSTILE[0], "python": HOSTILE[1], "numpy": HOSTILE[3], "detail": HOSTILE[1]}
    found = [
        row(problem, solver)
        | {"problem": names[problem], "scene": HOSTILE[k], "solver": solvers[solver]}
        | machine
        for problem in PROBLEMS
        for k, solver in enumerate(SOLVERS)
    ]
    for one in found:
        one["reason"] = one["reason"] and HOSTILE[5]
    run = reported(write_run(tmp_path / "<img src=x onerror=alert(1)>", found))
    rods = Rods(None, HOSTILE[1])
    portrait = Portrait(HOSTILE[4], "hash-one", HOSTILE[3], 40, "low", curves(run.solvers), HOSTILE, rods)
    write_page([Shown(run, [portrait]), Shown(run, [])], tmp_path / "page.html")
    page = open_page(tmp_path / "page.html")

    assert sorted(column(page, 1)) == sorted(names.values())
    assert texts(page, "#problems thead th")[4:] == run.solvers
    assert texts(page, ".shown:visible tbody tr:visible th") == run.solvers
    assert page.locator("#profile .legendtext").all_text_contents() == run.solvers
    assert page.locator("#reasons .legendtext").all_text_contents() == [HOSTILE[5]]
    assert texts(page, "#portrait-notes li") == HOSTILE
    assert page.locator("#rods-words").inner_text() == HOSTILE[1]
    assert page.locator("main img, main a, main script").count() == 0
    assert page.locator("script").count() == 3
    page.locator("#profile .nsewdrag").first.hover(position={"x": 300, "y": 50})
    page.locator("#reasons .nsewdrag").first.hover(position={"x": 20, "y": 40})
    page.locator("#problems th button").last.click()
    page.locator("#find").fill(HOSTILE[1])
    assert set(column(page, 1)) <= set(names.values())


def test_the_policy_lets_no_other_script_run(file, browser):
    page = browser.new_page()  # it complains
    page.goto(file.as_uri())
    page.evaluate("""() => {
        const added = document.createElement("script");
        added.textContent = "window.ran = 1";
        document.body.append(added);
        document.body.insertAdjacentHTML("beforeend", "<p onclick='window.ran = 2' id=added>x</p>");
        document.getElementById("added").click();
    }""")
    assert page.evaluate("window.ran") is None
    page.close()


@pytest.fixture(scope="module")
def core(tmp_path_factory):
    """The page of the committed run."""
    file = tmp_path_factory.mktemp("core") / "page.html"
    file.write_text(page_of_core306(), encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("report-light", {}),
        ("report-dark", {"color_scheme": "dark"}),
        ("report-narrow", {"viewport": {"width": 400, "height": 800}}),
    ],
)
def test_pictures_of_the_page_are_kept_and_nothing_sticks_out(core, open_page, name, settings):
    page = open_page(core, **settings)
    page.locator("#rods").scroll_into_view_if_needed()
    page.wait_for_selector("#rods canvas")
    width = page.evaluate("document.documentElement.scrollWidth")
    assert width <= settings.get("viewport", {"width": 1280})["width"]
    page.evaluate("window.scrollTo(0, 0)")
    shoot(page, name)
    dark = settings.get("color_scheme") == "dark"
    ink = page.evaluate("getComputedStyle(document.querySelector('#profile .legendtext')).fill")
    assert ink == ("rgb(233, 233, 236)" if dark else "rgb(29, 29, 31)")


def test_a_printed_page_is_light_and_has_all_problems(core, open_page):
    page = open_page(core, color_scheme="dark")
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print", color_scheme="dark")
    ink = page.evaluate("getComputedStyle(document.querySelector('#profile .legendtext')).fill")
    assert ink == "rgb(29, 29, 31)"
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert page.locator("#controls").is_hidden()
    box = page.locator("#problems")
    assert box.evaluate("(box) => box.clientHeight >= box.firstElementChild.clientHeight")
    assert page.locator("#problems tbody tr").count() == 306
