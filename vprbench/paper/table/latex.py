"""Any text as LaTeX that prints it."""

from __future__ import annotations

import re
import unicodedata

from vprbench.paper.templates import one_line

_GREEK = "αβγδεζηθικλμνξπρστυφχψωΓΔΘΛΞΠΣΥΦΨΩ"
_GREEK_NAMES = (
    "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau upsilon phi chi psi "
    "omega Gamma Delta Theta Lambda Xi Pi Sigma Upsilon Phi Psi Omega"
)
_SIGNS = {
    **{sign: f"\\{sign}" for sign in "&%$#{}"},
    **{"_": r"\_\allowbreak{}", "/": r"/\allowbreak{}"},  # names and paths may be long
    **{"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}", "`": r"\textasciigrave{}"},
    **{"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", '"': r"\textquotedbl{}"},
    **{"\u2018": r"\textquoteleft{}", "\u2019": r"\textquoteright{}", "€": r"\texteuro{}"},
    **{"\u201c": r"\textquotedblleft{}", "\u201d": r"\textquotedblright{}", "…": "..."},
    **{"\u2013": r"\textendash{}", "\u2014": r"\textemdash{}", "\u2212": "$-$"},
    **{"≤": r"$\leq$", "≥": r"$\geq$", "≈": r"$\approx$", "→": r"$\to$", "∞": r"$\infty$"},
    **{letter: rf"$\{name}$" for letter, name in zip(_GREEK, _GREEK_NAMES.split(), strict=True)},
}
_NOT_IN_T1 = "ĦħĸĿŀŉŦŧſ"  # of the letters up to ž


def tex(text: str) -> str:
    """Return text that LaTeX prints as it is; a sign that its fonts lack gives its plain letters or its number."""
    escaped = "".join(map(_sign, unicodedata.normalize("NFC", one_line(text))))
    return re.sub(r"([-,'])(?=\1)", r"\1{}", escaped)  # pairs of these would melt into one sign


def _sign(sign: str) -> str:
    if sign in _SIGNS:
        return _SIGNS[sign]
    if sign <= "ž" and sign not in _NOT_IN_T1:
        return sign
    plain = [part for part in unicodedata.normalize("NFKD", sign) if not unicodedata.combining(part)]
    return f"[U+{ord(sign):04X}]" if plain in ([], [sign]) else "".join(map(_sign, plain))
