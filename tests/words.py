#!/usr/bin/env python3
"""Checks the words of README, guide and code comments: tests/words.py [--long] [FILE...]

| checked | where | bound |
|---|---|---|
| a sentence has at most 30 words | README, guide | none longer |
| words of each part, tables and code left out | guide | 4000 a part, 900 for README |
| forms that hide who does what | README, guide | none |
| American spelling | README, guide, comments | none |
| sentences above 30 words | comments of each folder | tests/words.toml, which only shrinks |
| first line of a doc comment: at most 80 characters | code of each folder | tests/words.toml, which only shrinks |

`--self` checks planted mistakes. `--long` prints every long sentence of the code too. `--write` writes a smaller budget.
"""

import pathlib
import re
import subprocess
import sys
import tomllib

ROOT = pathlib.Path(__file__).resolve().parent.parent
BUDGET = ROOT / "tests/words.toml"
SENTENCE_WORDS = 30
DOC_CHARACTERS = 80
PARTS = {"README.md": 900, **{f"tools/guide/{p}": 4000 for p in ("integrator", "metrologist", "operator", "contributor")}}
# Written by the program from its help and its effects, whose words the code's budget holds.
GENERATED = {"tools/guide/reference/verbs.md", "tools/guide/reference/effects.md"}
FORMS = [
    r"\bIt is not that\b",
    r"\bwhich is told so\b",
    r"\b(?:is|are|was) said(?! of CODE)\b",
    r"\banew\b",
    r"\b(?:comes|come) to\b",
    r"\bholds no\b",
    r"\bwhich is no\b",
    r"\bthis door\b",
    r"\b\w+'s door\b",
    r"\bWhoever\b",
    r"\bcomes to the same\b",
]
# British spelling: the American word, and what to write.
AMERICAN = {
    r"(?<!no-)\bcolors?\b": "colour",
    r"\bbehaviors?\b": "behaviour",
    r"\bcenters?\b": "centre",
    r"\bcentered\b": "centred",
    r"\bmeters?\b(?! reading)": "metre",
    r"\b(?:milli|micro|kilo)meters?\b": "metre",
    r"\bneighbors?\b": "neighbour",
    r"\blicenses?\b": "licence",
    r"\banaly[z]e[ds]?\b": "analyse",
    r"\bcanceled\b": "cancelled",
    r"\bmodeled\b": "modelled",
    r"\blabeled\b": "labelled",
    r"\bfavorite\b": "favourite",
    r"\bgray\b": "grey",
    r"\baluminum\b": "aluminium",
}


def plain(text):
    """Text without code, links and emphasis: a piece of code is one word."""
    text = re.sub(r"`[^`]*`", "CODE", text)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return text.replace("**", "")


def paragraphs(page):
    """(line, text, is a table's cell) of a page of Markdown, blocks of code left out."""
    found, buffer, begin, fence = [], [], 0, False

    def flush():
        if buffer:
            found.append((begin, " ".join(buffer), False))
            buffer.clear()

    for number, line in enumerate(page.splitlines(), 1):
        text = line.strip()
        if text.startswith("```"):
            fence = not fence
            flush()
        elif fence or not text or text.startswith("![") or (line.startswith("    ") and not buffer):
            flush()
        elif text.startswith("|"):
            flush()
            if not re.fullmatch(r"[|\-: ]+", text):
                cells = re.split(r"(?<!\\)\|", text.strip("|"))
                found.extend((number, cell.strip(), True) for cell in cells if cell.strip())
        elif text.startswith("#"):
            flush()
            found.append((number, text.lstrip("# "), False))
        else:
            item = re.match(r"(?:[*-]|\d+\.) ", text)
            if item or not buffer:
                flush()
                begin = number
            buffer.append(text[item.end() :] if item else text)
    flush()
    return found


def sentences(text):
    """Sentences of a paragraph. A colon or a semicolon ends none."""
    return [s for s in re.split(r"(?<=[.!?])\s+|(?<=[.!?]\))\s+", plain(text)) if s.strip()]


def words(text):
    return len(re.findall(r"\S*\w\S*", text))


def long_sentences(text):
    return [s for s in sentences(text) if words(s) > SENTENCE_WORDS]


def check_page(name, page):
    """Findings of a page: line and what is wrong."""
    findings = []
    for line, text, _ in paragraphs(page):
        for s in long_sentences(text):
            findings.append(f"{name}:{line}: a sentence of {words(s)} words, expected at most {SENTENCE_WORDS}: {s[:70]}…")
        for form in FORMS:
            for hit in re.findall(form, plain(text), re.IGNORECASE):
                findings.append(f"{name}:{line}: found {hit!r}: say who does what")
    return findings + check_spelling(name, [(line, text) for line, text, _ in paragraphs(page)])


def check_spelling(name, texts):
    findings = []
    for line, text in texts:
        for pattern, british in AMERICAN.items():
            for hit in re.findall(pattern, plain(text)):
                findings.append(f"{name}:{line}: found {hit!r}, expected British spelling: {british!r}")
    return findings


def comments(code):
    """(line, text, is a doc comment) of every comment paragraph of a Rust file."""
    found, buffer, begin, kind, fence = [], [], 0, None, False

    def flush():
        if buffer:
            found.append((begin, " ".join(buffer), kind in ("///", "//!")))
            buffer.clear()

    for number, line in enumerate(code.splitlines(), 1):
        match = re.match(r"\s*(///|//!|//)(?!/)\s?(.*)", line)
        text = match.group(2).strip() if match else ""
        fence = bool(match) and fence != text.startswith("```")
        if fence:
            text = ""
        if not match or match.group(1) != kind or not text or re.match(r"[|#`]|[*-] |\d+\. ", text):
            flush()
        if match and text and not re.match(r"[|#`]", text):
            if not buffer:
                begin, kind = number, match.group(1)
            buffer.append(text)
        kind = match.group(1) if match else None
    flush()
    return found


def first_lines(code):
    """Lines of code whose doc comment begins with too long a line."""
    found, before = [], False
    for number, line in enumerate(code.splitlines(), 1):
        match = re.match(r"\s*//[/!]\s?(.*)", line)
        if match and not before and len(match.group(1)) > DOC_CHARACTERS:
            found.append(number)
        before = bool(match)
    return found


def tracked(*patterns):
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard", "--", *patterns], cwd=ROOT, check=True, capture_output=True, text=True)
    return [name for name in listed.stdout.splitlines() if (ROOT / name).is_file()]


def folder_of(name):
    """The room of a file: `driver`, `tools/model`, `tests/blind`."""
    parts = name.split("/")
    return "/".join(parts[:2]) if parts[0] == "tools" or parts[1] in ("blind", "needs", "papers") else parts[0]


def check_pages(pages):
    findings, count = [], {part: 0 for part in PARTS}
    for name in pages:
        page = (ROOT / name).read_text(encoding="utf-8")
        findings += check_page(name, page)
        for part in PARTS:
            if name == part or name.startswith(part + "/"):
                count[part] += sum(words(plain(text)) for _, text, cell in paragraphs(page) if not cell)
    for part, most in PARTS.items():
        print(f"{part}: {count[part]} words of prose, at most {most}")
        if count[part] > most:
            findings.append(f"{part}: {count[part]} words of prose, expected at most {most}")
    return findings


def check_code(files, budget, show):
    """Findings of the code, and what each folder has."""
    have, findings = {}, []
    for name in files:
        code = (ROOT / name).read_text(encoding="utf-8")
        found = have.setdefault(folder_of(name), {"long_sentences": 0, "long_first_lines": 0})
        texts = comments(code)
        for line, text, _ in texts:
            for s in long_sentences(text):
                found["long_sentences"] += 1
                if show:
                    print(f"{name}:{line}: {words(s)} words: {s[:90]}")
        lines = first_lines(code)
        found["long_first_lines"] += len(lines)
        if show:
            for line in lines:
                print(f"{name}:{line}: first line of a doc comment above {DOC_CHARACTERS} characters")
        findings += check_spelling(name, [(line, text) for line, text, _ in texts])
    for folder, found in sorted(have.items()):
        for key, n in found.items():
            most = budget.get(folder, {}).get(key, 0)
            if n > most:
                findings.append(f"{folder}: {key} {n}, expected at most {most} (tests/words.toml): shorten the new ones (--long shows all)")
            elif n < most:
                findings.append(f"{folder}: {key} {n}, tests/words.toml still allows {most}: run tests/words.py --write")
    return findings, have


def write_budget(have, before):
    """A budget never grows, and a new folder begins with none."""
    text = "# Long sentences and long first lines that comments still have, by folder. They only shrink: tests/words.py --write.\n"
    for folder, found in sorted(have.items()):
        text += f'\n["{folder}"]\n'
        for key, n in found.items():
            text += f"{key} = {min(n, before.get(folder, {}).get(key, 0)) if before else n}\n"
    BUDGET.write_text(text, encoding="utf-8")


def check_itself():
    """Planted mistakes must be found, and right words must pass."""
    thirty = " ".join(["word"] * 30)
    wrong = [
        f"{thirty} more.",
        f"| a cell | {thirty} more |",
        f"* {thirty}\n  more.",
        "The axis is said to be still.",
        "The color of the center.",
    ]
    right = [f"{thirty}.\n\n{thirty}.", f"```text\n{thirty} more\n```", "One. Two (`" + thirty + " more`).", "The centre's colour."]
    missed = [text for text in wrong if not check_page("planted", text)]
    false = [text for text in right if check_page("planted", text)]
    code = f"/// {thirty} more.\nfn f() {{}}\n// Short. {thirty}\n// more.\n"
    assert not missed and not false, (missed, false)
    assert sum(len(long_sentences(text)) for _, text, _ in comments(code)) == 2, comments(code)
    assert first_lines(code) == [1]
    print("planted mistakes were found")


def main(arguments):
    if "--self" in arguments:
        check_itself()
        return 0
    pages = tracked("README.md", "tools/guide/*.md", "tools/guide/**/*.md")
    findings = check_pages([p for p in dict.fromkeys(pages) if p not in GENERATED])
    budget = tomllib.loads(BUDGET.read_text(encoding="utf-8")) if BUDGET.exists() else {}
    of_code, have = check_code(tracked("*.rs"), budget, "--long" in arguments)
    if "--write" in arguments:
        write_budget(have, budget)
        of_code = []
    for finding in findings + of_code:
        print(finding)
    total = {key: sum(found[key] for found in have.values()) for key in ("long_sentences", "long_first_lines")}
    print(f"comments: {total['long_sentences']} sentences above {SENTENCE_WORDS} words, {total['long_first_lines']} long first lines")
    return 1 if findings or of_code else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
