"""Scripts and policy of an interactive page.

Bokeh from the installed package, our script, and a content security policy that allows these alone.
"""

import base64
import hashlib
import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

from hil.errors import NotPossibleError
from hil.report.interactive.numbers import numbers_json
from hil.report.zoomable import ZoomFigure

LIBRARY = ("bokeh.min.js", "bokeh-api.min.js")
OWN = ("plotting.js", "zoom.js")


@dataclass(frozen=True)
class InteractiveParts:
    """Parts of a page whose figures can be zoomed.

    Attributes:
        policy: Content security policy: the page may run and load these scripts only.
        scripts: Texts of the scripts, in their order.
        style: Rules for the figures.
        numbers: Numbers of the figures as JSON.
    """

    policy: str
    scripts: tuple[str, ...]
    style: str
    numbers: str


def interactive_parts(figures: Mapping[str, ZoomFigure]) -> InteractiveParts:
    """Parts for these figures, by key.

    Raises:
        NotPossibleError: Bokeh is not installed.
    """
    scripts, style = _scripts(), (resources.files("hil.report.interactive") / "zoom.css").read_text(encoding="utf-8")
    allowed = " ".join(f"'sha256-{_hash(script)}'" for script in scripts)
    policy = f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; font-src data:"
    return InteractiveParts(policy, scripts, style, numbers_json(figures))


def check_interactive() -> None:
    """Refuse to go on without the library.

    Raises:
        NotPossibleError: It is not installed.
    """
    if importlib.util.find_spec("bokeh") is None:
        raise NotPossibleError("an interactive report needs bokeh, which is not installed: pip install 'hil-bench[live]'")


@cache
def _scripts() -> tuple[str, ...]:
    check_interactive()
    library, own = resources.files("bokeh") / "server" / "static" / "js", resources.files("hil.report.interactive")
    texts = [(library / name).read_text(encoding="utf-8") for name in LIBRARY]
    texts += [(own / name).read_text(encoding="utf-8") for name in OWN]
    return tuple(_inline(text) for text in texts)


def _inline(text: str) -> str:
    """Make a script safe to inline.

    It cannot end its element early, and has the line ends that a browser hashes.
    """
    return text.replace("\r\n", "\n").replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
