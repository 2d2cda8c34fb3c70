"""Walks over all controls of a page in a browser: where they are, and what happens when each is used once."""

import time
from collections.abc import Callable, Mapping
from typing import Any

from reading_clients import open_panel

PATIENCE_S = 60.0

CONTROLS = """() => {
  const label = e => {
    for (let box = e; box; box = box.parentElement) {
      const named = box.querySelector('label');
      if (named) return named.innerText.trim();
    }
    return '';
  };
  const clip = e => {
    let {left, right, top, bottom} = e.getBoundingClientRect();
    for (let box = e.parentElement; box; box = box.parentElement) {
      const style = getComputedStyle(box);
      if (style.visibility === 'hidden' || style.display === 'none') return null;
      if (style.overflowX !== 'visible' || style.overflowY !== 'visible') {
        const edge = box.getBoundingClientRect();
        [left, right] = [Math.max(left, edge.left), Math.min(right, edge.right)];
        [top, bottom] = [Math.max(top, edge.top), Math.min(bottom, edge.bottom)];
      }
    }
    return right - left > 1 && bottom - top > 1 ? [left, top, right, bottom] : null;
  };
  const found = [], seen = {};
  for (const e of document.querySelectorAll('button, [role=slider], input:not([type=hidden]):not([type=file])')) {
    const box = e.getBoundingClientRect();
    if (box.width === 0 || e.disabled || e.closest('.mantine-Notifications-root') || !e.closest('[class*=mantine]')) continue;
    if (getComputedStyle(e).visibility === 'hidden' || e.closest('[inert]')) continue;  // inert: of a panel that closes
    const kind = e.tagName === 'BUTTON' ? 'button' : e.type === 'checkbox' ? 'checkbox' : e.inputMode ? 'number' : 'text';
    const role = (e.getAttribute('role') || '').replace('combobox', 'menu') || kind;
    if (role === 'tab') continue;
    const name = role === 'button' ? e.innerText.trim() : label(e);
    const times = seen[role + name] = (seen[role + name] || 0) + 1;
    e.dataset.walk = `${role}|${name}|${times}`;
    found.push({key: e.dataset.walk, role, name, box: clip(e), width: [box.left, box.right]});
  }
  return found;
}"""
"""All controls that can be used, by role and name, and the part of each that is not clipped by a scrolled panel."""


def controls_of(tab: Any) -> list[dict[str, Any]]:
    return list(tab.evaluate(CONTROLS))


Condition = Callable[[], bool]


def use_every_control(
    tab: Any, refresh: Callable[[], None], used: set[str], last: Mapping[str, tuple[Condition, Condition]] | None = None
) -> None:
    """Press every button, move every slider, choose every option and fill every field of what is open and not yet in `used`.

    last: names of controls that are used after all others, in this order, because they take others away and bring new ones; with
    what must hold before each is used, and what holds once the page has followed.
    """
    conditions = last or {}
    order = list(conditions)
    while True:
        refresh()
        fresh = [control for control in controls_of(tab) if control["key"] not in used and control["name"]]
        if not fresh:
            return
        control = min(fresh, key=lambda each: order.index(each["name"]) + 1 if each["name"] in order else 0)
        used.add(control["key"])
        before, after = conditions.get(control["name"], (lambda: True, lambda: True))
        _follow(tab, refresh, before)
        _use(tab, control, refresh, used)
        _follow(tab, refresh, after)


def _follow(tab: Any, refresh: Callable[[], None], until: Callable[[], bool]) -> None:
    give_up_at = time.monotonic() + PATIENCE_S
    while not until():
        assert time.monotonic() < give_up_at, f"expected the page to follow, got:\n{tab.inner_text('body')}"
        refresh()
        tab.wait_for_timeout(100)


def _use(tab: Any, control: dict[str, Any], refresh: Callable[[], None], used: set[str]) -> None:
    element = tab.locator(f"[data-walk={_quoted(control['key'])}]").first
    if control["role"] in ("button", "checkbox"):
        element.dispatch_event("click")
    elif control["role"] == "slider":
        element.focus()
        tab.keyboard.press("ArrowRight")
    elif control["role"] == "menu":
        _choose_every_option(tab, control["key"], refresh, used)
    else:
        element.fill("1.5" if control["role"] == "number" else "a name")
        element.press("Enter")
        element.blur()


CHOOSE = """async ([key, used]) => {
  const menu = [...document.querySelectorAll('input')].find(each => each.dataset.walk === key);
  menu.scrollIntoView({block: 'center'});  // a menu that is out of sight shows no options
  const shown = () => [...document.querySelectorAll('[role=option]')].filter(each => each.checkVisibility());
  for (let waited = 0; !shown().length && waited < 30000; waited += 50) {
    if (waited % 3000 === 0) menu.click();
    await new Promise(done => setTimeout(done, 50));
  }
  const names = shown().map(each => each.innerText);
  const fresh = Math.max(names.findIndex(name => !used.includes('option|' + name)), 0);
  if (names.length) shown()[fresh].click();
  return [names, fresh];
}"""
"""Opens a menu, which takes no click for a moment after it was closed, and chooses the first option that has not been used."""


def _choose_every_option(tab: Any, key: str, refresh: Callable[[], None], used: set[str]) -> None:
    """Choose all options of a menu that no menu had before, one after the other, and at least one."""
    while True:
        names, chosen = tab.evaluate(CHOOSE, [key, sorted(used)])
        assert names, f"expected a menu that opens, got none: {key}"
        used.add(f"option|{names[chosen]}")
        refresh()
        if all(f"option|{name}" in used for name in names):
            return


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\a ")
    return f'"{escaped}"'


def find_layout_faults(tab: Any) -> list[str]:
    """Controls outside of the browser's window or over each other, images that are not there, and sideways scrolling."""
    width = tab.evaluate("innerWidth")
    faults = [] if tab.evaluate("document.documentElement.scrollWidth") <= width else ["the page scrolls sideways"]
    shown = [control for control in controls_of(tab) if control["box"] is not None]
    faults += [
        f"{control['key']} is outside: {control['width']}"
        for control in shown
        if control["width"][0] < -1 or control["width"][1] > width + 1
    ]
    for number, one in enumerate(shown):
        faults += [f"{one['key']} is over {other['key']}" for other in shown[number + 1 :] if _overlap(one, other)]
    broken = (
        "[...document.querySelectorAll('img:not([hidden])')].filter(i => !i.complete || i.naturalWidth === 0).length"
    )
    return [*faults, *(["an image is not there"] if _stays_true(tab, broken) else [])]


def _stays_true(tab: Any, question: str, for_s: float = 3.0) -> bool:
    """Whether a question is answered with yes all the time: an image that has just changed is being decoded."""
    give_up_at = time.monotonic() + for_s
    while tab.evaluate(question):
        if time.monotonic() > give_up_at:
            return True
        time.sleep(0.05)
    return False


def _overlap(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two controls cover each other; two parts of one field may."""
    if one["name"] == other["name"] or not (one["name"] and other["name"]):
        return False
    (a, b, c, d), (e, f, g, h) = one["box"], other["box"]
    return min(c, g) - max(a, e) > 2 and min(d, h) - max(b, f) > 2


def panels_of(tab: Any) -> list[str]:
    return [label.inner_text().strip() for label in tab.get_by_role("tab").all()]


def open_every_panel(tab: Any, refresh: Callable[[], None], then: Callable[[str], None]) -> None:
    for name in panels_of(tab):
        open_panel(tab, name)
        for _ in range(3):
            refresh()
        then(name)
