"""prose.py FILE..: prints sentences of Markdown prose that are too long, and phrases that a native writer would not use.

Ignores tables, code and headings. Exit status 1 if there are any."""

import re
import statistics
import sys

RIDDLES = [
    r"\b(is|are) said\b",
    r"\bsaid to be\b",
    r"\bas is why\b",
    r"\bof which nothing\b",
    r"\bis told where\b",
    r"\b(is|are) none of (this|that) kind\b",
    r"\bfor which .* speaks\b",
    r"\bis no more\b",
    r"\b(left|taken) out\b",
    r"\banew\b",
]
LONGEST, MEDIAN, FEW = 40, 18, 5


def prose(text):
    text = re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.S)
    blocks = []
    for block in re.split(r"\n\s*\n", text):
        lines = block.splitlines()
        if not lines or lines[0].startswith(("    ", "|", "#", "![")):
            continue
        for item in re.split(r"\n\s*(?:[-*]|\d+\.) ", "\n" + block):
            item = item.split("\n|")[0]
            blocks.append(re.sub(r"\s+", " ", item).strip())
    return blocks


def sentences(block):
    block = re.sub(r"`[^`]*`", "code", block)
    block = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", block)
    return [s for s in re.split(r"(?<=[.!?:;])\s+(?=[A-Z*\"(0-9a-z])", block) if s.strip()]


bad = 0
for path in sys.argv[1:]:
    lengths = []
    for block in prose(open(path, encoding="utf-8").read()):
        for sentence in sentences(block):
            words = len(re.findall(r"[\w'/-]+", sentence))
            if words > 2:
                lengths.append(words)
            if words > LONGEST:
                bad += 1
                print(f"{path}: {words} words: {sentence[:110]}")
            for riddle in RIDDLES:
                if re.search(riddle, sentence, re.I):
                    bad += 1
                    print(f"{path}: {riddle}: {sentence[:110]}")
    if len(lengths) > FEW and statistics.median(lengths) > MEDIAN:
        bad += 1
        print(f"{path}: median sentence of {statistics.median(lengths)} words")
sys.exit(bad > 0)
