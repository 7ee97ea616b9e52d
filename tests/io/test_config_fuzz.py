"""Config files damaged in every way that chance finds: refused in words and at once, or read.

``TRACKER_FUZZ=100000`` chooses how many; the same number tries the same files. A failure prints the
seed of the one file that caused it.
"""

import os
import random
import re
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from tracker.errors import ConfigError
from tracker.io.config import Experiment, read_experiment

EXAMPLES = Path(__file__).parents[2] / "examples"
COUNT = int(os.environ.get("TRACKER_FUZZ", "2000"))
TOKEN = re.compile(r"""\s+|"[^"\n]*"|[\w.+-]+|.""", re.DOTALL)
# Bounded, lest looking for places in a file of brackets takes longer than reading it.
VALUE = re.compile(r"(?<== )(\"[^\"\n]{0,99}\"|\[[^\]\n]{0,99}\]|[\w.+-]{1,99})")
KEY = re.compile(r"\b[a-z_]{1,99}(?= =)")
ODD = (
    *("inf", "-inf", "nan", "-1", "0", "-0.0", "1e308", "1e-308", "1e999", "5e-324", "1e15", "9" * 400),
    *("9" * 5000, "0x" + "f" * 9000, "0b" + "1" * 9000, "1." + "3" * 20000, "true", "false", "[]", "{}"),
    *('""', '" "', '"6"', '"nan"', '"os.system"', '"tracker_kalman.ekf1:ExtendedKalmanFilter"', "''"),
    *('"\\u0000"', '"\\n"', '"a\\u202eb"', '"../../../../../.."', '"/dev/zero"', '"/"', '"."', '"~"'),
    *("1979-05-27", "07:32:00", "1979-05-27T07:32:00Z", "2020-13-45", '"""\n"""', "[[1.0]]", "[1, 'a']"),
    *("[1.0, 2.0]", "[nan, inf]", "[true, false]", "{a = 1}", "[{}]", '{name = "ekf1"}', '["eo", "eo"]'),
)  # fmt: skip


def bytes_change(text: str, rng: random.Random) -> str:
    data = bytearray(text.encode("utf-8", "surrogateescape"))
    for _ in range(rng.randint(1, 8)):
        at = rng.randrange(len(data) + 1)
        choice = rng.randrange(3)
        if choice == 0:
            data[at : at + 1] = bytes([rng.randrange(256)])
        elif choice == 1:
            data[at:at] = bytes([rng.choice(b"[]{}=.,\"'#\\\n\r\t \x00\xff-_0aeE+")])
        else:
            del data[at : at + rng.randint(1, 10)]
    return data.decode("utf-8", "surrogateescape")


def tokens_change(text: str, rng: random.Random) -> str:
    tokens = TOKEN.findall(text) or [""]
    a, b = rng.randrange(len(tokens)), rng.randrange(len(tokens))
    choice = rng.randrange(3)
    if choice == 0:
        tokens[a], tokens[b] = tokens[b], tokens[a]
    elif choice == 1:
        tokens.insert(a, tokens[b])
    else:
        del tokens[a]
    return "".join(tokens)


def lines_change(text: str, rng: random.Random) -> str:
    lines = text.split("\n")
    a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
    choice = rng.randrange(4)
    if choice == 0:
        lines[a], lines[b] = lines[b], lines[a]
    elif choice == 1:
        lines.insert(a, lines[b])
    elif choice == 2:
        del lines[a]
    else:
        lines[a] = lines[a] * rng.choice((2, 50))
    return "\n".join(lines)


def replaced(
    pattern: re.Pattern[str], text: str, rng: random.Random, by: Callable[[str], str]
) -> str:
    places = list(pattern.finditer(text))
    if not places:
        return text + by("x")
    place = rng.choice(places)
    return text[: place.start()] + by(place.group()) + text[place.end() :]


def values_become_odd(text: str, rng: random.Random) -> str:
    return replaced(VALUE, text, rng, lambda _: rng.choice(ODD))


def values_change_places(text: str, rng: random.Random) -> str:
    others = VALUE.findall(text) or ["1"]
    return replaced(VALUE, text, rng, lambda _: rng.choice(others))


def values_nest(text: str, rng: random.Random) -> str:
    depth = rng.choice((1, 15, 16, 17, 200, 3000, 30000))
    left, right = rng.choice((("[", "]"), ("{a = ", "}"), ("[{a = ", "}]")))
    closed = rng.random() < 0.8
    return replaced(VALUE, text, rng, lambda value: left * depth + value + right * (depth * closed))


def texts_grow(text: str, rng: random.Random) -> str:
    long = rng.choice(("x", "\\u00e9", "\N{SNOWMAN}", "a.", "\\\\", " ")) * rng.choice(
        (300, 5000, 40000)
    )
    choice = rng.randrange(3)
    if choice == 0:
        return replaced(VALUE, text, rng, lambda _: f'"{long}"')
    return replaced(
        KEY, text, rng, lambda _: f'"{long}"' if choice == 1 else long.strip(".") or "a"
    )


def keys_get_typos(text: str, rng: random.Random) -> str:
    def typo(key: str) -> str:
        at = rng.randrange(len(key))
        letters = [
            key[:at] + key[at + 1 :],
            key[:at] + rng.choice("aeiou_-.0 ") + key[at:],
            key * 2,
        ]
        return rng.choice((*letters, key.upper(), f'"{key}"', "__class__", ""))

    return replaced(KEY, text, rng, typo)


MUTATIONS = (
    bytes_change,
    tokens_change,
    lines_change,
    values_become_odd,
    values_change_places,
    values_nest,
    texts_grow,
    keys_get_typos,
)


def mutated(text: str, seed: int) -> bytes:
    rng = random.Random(seed)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        text = rng.choice(MUTATIONS)(text, rng)[:200_000]
    return text.encode("utf-8", "surrogatepass" if rng.random() < 0.5 else "replace")


def test_a_damaged_config_is_refused_in_words_within_a_second(tmp_path: Path) -> None:
    original = (EXAMPLES / "harbour.toml").read_text(encoding="utf-8")
    original = original.replace('"data/', f'"{(EXAMPLES / "data").as_posix()}/')
    file = tmp_path / "scene.toml"
    outcomes: Counter[str] = Counter()
    slowest = (0.0, -1)
    for seed in range(COUNT):
        file.write_bytes(mutated(original, seed))
        start = time.process_time()
        try:
            read = read_experiment(file)
        except ConfigError as error:
            outcomes["refused"] += 1
            message = str(error)
            assert message.startswith(f"{file}"), (seed, message)
            assert len(message) < 8000, (seed, len(message))
        except BaseException as error:
            raise AssertionError(f"seed {seed} raises {type(error).__name__}") from error
        else:
            outcomes["read"] += 1
            assert isinstance(read, Experiment)
        slowest = max(slowest, (time.process_time() - start, seed))
    print(f"{dict(outcomes)}; slowest {slowest[0]:.3f} s (seed {slowest[1]})")  # noqa: T201 - pytest -s
    assert slowest[0] < 1.0, f"seed {slowest[1]} took {slowest[0]:.2f} s"
    assert min(outcomes["refused"], outcomes["read"]) > COUNT // 50, (
        f"the damage is all of one kind, so that little is tried: {outcomes}"
    )
