"""Equations of docstrings, typeset: plain lines, as one writes them in an editor, become TeX that KaTeX shows.

What is understood, beside + - = <= < > != ~ and brackets: `a b` and `a*b` are products; `a b/(c d)` is a fraction of
the factors right before and the one factor after; x^2, x_max, x_{k+1}, x1, x'; e_dot is a dot over e; `<-`, `+-`, `-+`,
|x|; greek letters and functions by their names; [m/s] is a unit; `code`. Names of several letters are upright, and so
are words. A line that is indented deeper than the first goes on with the one before it.
"""

from __future__ import annotations

import html
import re
from dataclasses import dataclass, replace


def _names(text: str) -> frozenset[str]:
    return frozenset(text.split())


GREEK = _names("alpha beta gamma delta kappa lambda mu nu omega phi pi psi rho sigma tau theta")
BY_TEX = _names("arctan cos exp ln max min sin tan tanh")
FUNCTIONS = _names("atan atan2 atanh clip cross fiala floor sat sigmoid smoothstep wrap")
LARGE = {"sum": r"\sum", "argmin": r"\operatorname*{arg\,min}", "max": r"\max", "min": r"\min"}
WORDS = _names(
    "and any as at below beyond but by each else every for from if in is never new nor not of on or otherwise so "
    "terminal that the then to until where which while with within"
)
RELATIONS = {
    "<-": r"\leftarrow",
    "+=": r"\mathrel{+}=",
    "<=": r"\le",
    ">=": r"\ge",
    "!=": r"\neq",
    "~": r"\approx",
    "=": "=",
    "<": "<",
    ">": ">",
}
SIGNS = {"+-": r"\pm", "-+": r"\mp", "+": "+", "-": "-", ".": r"\cdot", "mod": r"\bmod"}
PAIRS = {"(": ")", "[": "]", "{": "}"}

_UNIT = r"(?:kg|rad|deg|Hz|kN|[msN1])(?:\^\d)?"
_UNITS = rf"{_UNIT}(?:[ /]{_UNIT})*"
TOKEN = re.compile(
    rf"""(?P<code>`[^`]*`)
    |(?P<unit>\[{_UNITS}\])
    |(?P<quantity>(?<![\w.])(?:\d+\.\d+|(?<!/)\d+)\ (?:m/s\^\d|m/s|rad/s|Hz|s|m|rad)
        (?=\ *(?:[,.;:)\]]|$)|\ +[a-z]{{2}}))
    |(?P<number>\d+(?:\.\d+)?(?:e-?\d+)?)
    |(?P<name>[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)*)
    |(?P<sub>_\{{|_(?=\w))
    |(?P<dots>\.\.\.)
    |(?P<dot>\.(?=[A-Za-z]))
    |(?P<mark>[,;:.](?=\s|$))
    |(?P<sign><-|\+=|\+-|-\+|<=|>=|!=|[-+*/^~=<>|()\[\]{{}}'])""",
    re.VERBOSE,
)
_SYMBOL = rf"(?:{'|'.join((*GREEK, *BY_TEX, *FUNCTIONS))}|sum(?! of)|mod|d[A-Za-z])\b"
WORD = re.compile(rf"(?!{_SYMBOL})(?:[A-Za-z]{{3,}}(?:-[A-Za-z]{{3,}})+|[A-Za-z]+(?:'s)?)(?=[\s,;:.)]|$)")


class FormulaError(ValueError):
    """A line that is no equation: where reading stopped."""


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    space: int
    """Blanks before it."""


@dataclass(frozen=True)
class _Piece:
    """Of what is shown: its TeX; kind: factor, fraction, sign, text or mark; tall: brackets have to grow around it."""

    tex: str
    kind: str = "factor"
    tall: bool = False
    inner: str = ""
    """What stands in the brackets of a bracketed factor: a fraction needs them no longer."""
    space: int = 0
    word: bool = False


def typeset(text: str) -> str:
    """HTML of some lines of equations: a `data-tex` for each, which docs/formulas.js fills, and words between them."""
    rows = "".join(f'<div class="row">{_row(line)}</div>' for line in _lines(text))
    plain = html.escape(text).replace("\n", "&#10;")
    return f'<div class="equations">{rows}<noscript><pre>{plain}</pre></noscript></div>'


def tex(line: str) -> str:
    """TeX of one line, words and all."""
    return _joined(_as_text(_Reader(line).all()))


def _lines(text: str) -> list[str]:
    """A line that is indented deeper than the first goes on with the one before it."""
    lines: list[str] = []
    for line in text.split("\n"):
        if lines and line.startswith("  "):
            lines[-1] += "  " + line.strip()
        else:
            lines.append(line)
    return lines


def _row(line: str) -> str:
    """Items up to a comma or a wide gap, each kept together where the page is wide enough."""
    items: list[list[str]] = [[]]
    formula: list[_Piece] = []
    wide: list[bool] = [False]

    def close() -> None:
        if formula:
            sided = "{}" if formula[0].tex in "+-" and items[-1] else ""  # after words, too, it has two sides
            items[-1].append(f'<span data-tex="{html.escape(sided + _joined(formula))}"></span>')
            formula.clear()

    ended = False
    pieces = _Reader(line).all()
    for before, piece in zip([_Piece(""), *pieces], pieces):
        gap = piece.space >= 2 and "sign" not in (piece.kind, before.kind)  # blanks at a sign are for the source's eye
        if gap or ended:
            close()
            if items[-1]:
                items.append([])
                wide.append(gap)
        ended = piece.kind == "mark" and piece.tex in ",;"
        if piece.kind == "mark":
            if formula:
                formula.append(piece)  # no line begins with a comma
            else:
                items[-1] = ["".join(items[-1]).rstrip() + piece.tex + " "]
        elif piece.kind == "text":
            close()
            items[-1].append((" " if items[-1] else "") + _words(piece.tex) + " ")
        else:
            formula.append(piece)
    close()
    classes = ("item", "item wide")
    return " ".join(f'<span class="{classes[gap]}">{"".join(item).strip()}</span>' for item, gap in zip(items, wide))


def _words(text: str) -> str:
    return re.sub("`([^`]*)`", r"<code>\1</code>", html.escape(text))


def _joined(pieces: list[_Piece]) -> str:
    shown = ""
    for before, piece in zip([None, *pieces], pieces):
        if before is not None:
            factors = {before.kind, piece.kind} <= {"factor", "fraction"} and piece.space
            words = before.word + piece.word
            shown += (r"\,", r"\;", r"\ ")[words] if factors else " "
        shown += piece.tex
    return shown


class _Reader:
    """Reads one line, a bracket within a bracket."""

    def __init__(self, line: str):
        self.line = line
        self.tokens = _tokens(line)
        self.k = 0

    def all(self) -> list[_Piece]:
        pieces = self.pieces("")
        if self.k < len(self.tokens):
            raise FormulaError(f"{self.line!r}: {self.tokens[self.k].text!r} closes nothing")
        return pieces

    def pieces(self, closing: str) -> list[_Piece]:
        """Up to the bracket that closes, which is left."""
        found: list[_Piece] = []
        while self.k < len(self.tokens):
            token = self.tokens[self.k]
            if token.text == closing or (token.kind == "sign" and token.text in PAIRS.values()):
                break
            if token.text == "/":
                self.k += 1
                found.append(_over(_numerator(found, self.line), self.factor()))
            elif token.text == "*" and found:
                self.k += 1
                found[-1] = replace(found[-1], word=False)
                found.append(replace(self.factor(), space=1, word=False))
            else:
                found.append(self.piece())
        return found

    def piece(self) -> _Piece:
        token = self.tokens[self.k]
        if token.kind in ("text", "mark"):
            self.k += 1
            return _Piece(token.text, token.kind, space=token.space)
        if token.kind == "dots":
            self.k += 1
            return _Piece(r"\ldots", space=token.space)
        tex = RELATIONS.get(token.text) or SIGNS.get(token.text)
        if tex:
            self.k += 1
            return _Piece(tex, "sign", space=token.space)
        return self.factor()

    def factor(self) -> _Piece:
        """A number, name or bracket with all that hangs on it."""
        if self.k == len(self.tokens):
            raise FormulaError(f"{self.line!r} ends where a number, a name or a bracket is expected")
        token = self.tokens[self.k]
        self.k += 1
        if token.text == "-":
            after = self.factor()
            return _Piece("-" + after.tex, tall=after.tall, space=token.space)
        if token.text in PAIRS or token.text == "|":
            found = self.bracket(token)
        elif token.kind == "name":
            found = self.named(token)
        elif token.kind in ("number", "quantity", "unit", "code"):
            found = _Piece(_plain(token), space=token.space)
        else:
            raise FormulaError(f"{self.line!r}: {token.text!r} where a number, a name or a bracket is expected")
        return self.hung(found)

    def bracket(self, opened: _Token) -> _Piece:
        closing = PAIRS.get(opened.text, "|")
        inside = self.pieces(closing)
        if self.k == len(self.tokens) or self.tokens[self.k].text != closing:
            raise FormulaError(f"{self.line!r}: {opened.text!r} is not closed")
        self.k += 1
        inner = _joined(_as_text(inside))
        tall = any(piece.tall for piece in inside)
        left, right = {"(": "()", "[": "[]", "{": (r"\{", r"\}"), "|": (r"\lvert", r"\rvert")}[opened.text]
        shown = rf"\left{left} {inner} \right{right}" if tall else f"{left} {inner} {right}"
        return _Piece(shown, tall=tall, inner=inner if opened.text in "({" else "", space=opened.space)

    def named(self, token: _Token) -> _Piece:
        after = self.tokens[self.k] if self.k < len(self.tokens) else None
        called = after is not None and after.text == "(" and not after.space
        if token.text == "sqrt" and called:
            self.k += 1
            return _Piece(rf"\sqrt{{{self.bracket(self.tokens[self.k - 1]).inner}}}", tall=True, space=token.space)
        word = re.fullmatch("[A-Za-z]{2,}", token.text) is not None and symbol(token.text).startswith(r"\mathrm")
        return _Piece(symbol(token.text), space=token.space, word=word)

    def hung(self, found: _Piece) -> _Piece:
        """Primes, indices, powers and arguments that follow without a blank."""
        tex, tall, inner, word = found.tex, found.tall, found.inner, found.word
        while self.k < len(self.tokens) and not self.tokens[self.k].space:
            mark = self.tokens[self.k]
            if mark.text == "'":
                tex += "'"
                self.k += 1
            elif mark.kind == "sub":
                self.k += 1
                tex += "_{" + (self.index() if mark.text == "_{" else self.named(self.next()).tex) + "}"
            elif mark.text == "^":
                self.k += 1
                power = self.power()
                tex = f"{{{tex}}}^{{{power}}}" if "'" in tex else f"{tex}^{{{power}}}"
            elif mark.text in "([" and not inner:
                self.k += 1
                arguments = self.bracket(mark)
                tex, tall = tex + arguments.tex, tall or arguments.tall
                word = False
                continue
            else:
                break
            inner, word = "", False
        return _Piece(tex, tall=tall, inner=inner, space=found.space, word=word)

    def next(self) -> _Token:
        self.k += 1
        return self.tokens[self.k - 1]

    def index(self) -> str:
        return self.bracket(_Token("sign", "{", 0)).inner

    def power(self) -> str:
        token = self.next()
        if token.text == "(":
            return self.bracket(token).inner
        return _plain(token) if token.kind == "number" else symbol(token.text)


def symbol(name: str) -> str:
    """TeX of a name: greek, a letter with indices, a function, or an upright word."""
    head, *indices = name.split("_")
    if head in LARGE and indices:
        return LARGE[head] + "_{" + ",".join(map(symbol, indices)) + "}"
    if name in BY_TEX:
        return "\\" + name
    if name in FUNCTIONS or name in LARGE:
        return rf"\operatorname{{{name}}}" if name in FUNCTIONS else LARGE[name]
    numbered = re.fullmatch(r"([A-Za-z]+?)(\d+)", head)
    if numbered:
        head, indices = numbered[1], [numbered[2], *indices]
    if head not in GREEK and len(head) > 1 and not re.fullmatch(rf"d(?:[A-Za-z]|{'|'.join(GREEK)})", head):
        index = f"_{{{indices.pop()}}}" if indices and len(indices[-1]) == 1 else ""
        return r"\mathrm{" + r"\_".join([head, *indices]) + "}" + index
    shown = f"\\{head}" if head in GREEK else head
    if len(head) > 1 and head not in GREEK:
        shown = r"\mathrm{d}" + (f"\\{head[1:]} " if head[1:] in GREEK else head[1:])
    if indices[:1] == ["dot"]:
        shown, indices = rf"\dot{{{shown}}}", indices[1:]
    return shown + ("_{" + ",".join(_index(one) for one in indices) + "}" if indices else "")


def _index(name: str) -> str:
    if name in GREEK:
        return "\\" + name
    return name if len(name) == 1 or name.isdigit() else rf"\mathrm{{{name}}}"


def _plain(token: _Token) -> str:
    if token.kind == "quantity":
        number, unit = token.text.split(" ")
        return rf"{number}\,\mathrm{{{unit}}}"
    if token.kind == "unit":
        return r"\ \mathrm{" + token.text.replace(" ", r"\,") + "}"
    if token.kind == "code":
        return r"\texttt{" + token.text.strip("`").replace("_", r"\_") + "}"
    return token.text


def _numerator(found: list[_Piece], line: str) -> list[_Piece]:
    """Takes away the factors before a stroke: all of a product, but no word that only stands beside it."""
    taken: list[_Piece] = []
    while found and found[-1].kind == "factor" and (not taken or not (found[-1].word or taken[0].space >= 2)):
        taken.insert(0, found.pop())
    if not taken:
        raise FormulaError(f"{line!r}: nothing stands over a fraction stroke")
    return taken


def _as_text(pieces: list[_Piece]) -> list[_Piece]:
    """With blanks around words, but not beside a bracket or a comma."""
    found = []
    for k, piece in enumerate(pieces):
        before = " " if k and piece.space else ""
        after = " " if k + 1 < len(pieces) and pieces[k + 1].kind != "mark" else ""
        text = rf"\text{{{before}{piece.tex}{after}}}"
        found.append(replace(piece, tex=text) if piece.kind == "text" else piece)
    return found


def _over(above: list[_Piece], below: _Piece) -> _Piece:
    top = above[0].inner if len(above) == 1 and above[0].inner else _joined(above)
    return _Piece(rf"\frac{{{top}}}{{{below.inner or below.tex}}}", "fraction", tall=True, space=above[0].space)


def _tokens(line: str) -> list[_Token]:
    tokens: list[_Token] = []
    at = 0
    while at < len(line):
        space = len(line[at:]) - len(line[at:].lstrip())
        at += space
        if at == len(line):
            break
        prose = "" if tokens and tokens[-1].text in ("/", "^", "_") else _prose(line[at:])
        found = TOKEN.match(line, at)
        if prose:
            tokens.append(_Token("text", prose, space))
            at += len(prose)
        elif found:
            kind = "text" if found.lastgroup == "code" and not _inside(tokens) else found.lastgroup
            tokens.append(_Token(str(kind), found[0], space))
            at = found.end()
        else:
            raise FormulaError(f"{line!r}: {line[at]!r} is not understood")
    return tokens


def _inside(tokens: list[_Token]) -> bool:
    opened = sum((token.text in PAIRS) - (token.text in PAIRS.values()) for token in tokens)
    return opened > 0


def _prose(rest: str) -> str:
    """Words of English that begin here: of the list, two names with a hyphen, or three and more in a row."""
    words: list[str] = []
    at = 0
    while found := WORD.match(rest, at):
        words.append(found[0])
        at = found.end() + 1
        if rest[found.end() : at] != " " or rest[at : at + 1] == " ":
            break
    while len(words) > 1 and len(words[-1]) == 1:
        words.pop()  # a symbol that follows
    if len(words) >= 3 and sum(len(word) >= 3 for word in words) >= 2 and (len(words[0]) > 1 or words[0] == "a"):
        return " ".join(words)
    while words and not (words[-1] in WORDS or words[-2:-1] == ["at"] or "-" in words[-1]):
        words.pop()
    return " ".join(words) if words and (words[0] in WORDS or "-" in words[0]) else ""
