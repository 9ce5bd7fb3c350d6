"""Small files that stand for a great deal, as PyYAML's and yq's issues collect them."""

from itertools import pairwise

LIST_BOMB = "a: &a [0,0,0,0,0,0,0,0,0]\n" + "".join(
    f"{name}: &{name} [" + ",".join([f"*{before}"] * 9) + "]\n"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)
"""9 to the power of 9 leaves."""


def merge_bomb(levels: int) -> str:
    """Mappings that each merge the one before nine times."""
    names = "abcdefghijklm"[: levels + 1]
    return "a: &a {x1: 1}\n" + "".join(
        f"{name}: &{name} {{" + ", ".join([f"<<: *{before}"] * 9) + "}\n" for before, name in pairwise(names)
    )


BOMBS = {
    "list": LIST_BOMB,
    "list-in-a-study": "name: ab\nrobot:\n" + "".join(f"  {line}\n" for line in LIST_BOMB.splitlines()),
    **{f"merge-{levels}": merge_bomb(levels) for levels in range(7, 13)},
    "brackets": "name: " + "[" * 5000,
    "digits": "name: ab\nlearning: {epochs: " + "9" * 5000 + "}\n",
    "megabytes": "name: ab\nseeds: [" + "0, " * 3_500_000 + "0]\n",
    "itself": "name: ab\nsweep: &a {physics.dt: [*a, *a]}\n",
    "aliases": "name: ab\nconditions:\n  b: &b {wobble: null}\n" + "".join(f"  c{i}: *b\n" for i in range(50_000)),
    "text": f"name: &a {'long' * 20_000}\nsweep: {{physics.dt: [" + "*a, " * 9_000 + "]}\n",
    "unknown-keys": "name: ab\n" + "".join(f"k{i}: 1\n" for i in range(10_000)),
    "swept-keys": "name: ab\nsweep:\n" + "".join(f"  k{i}: [1]\n" for i in range(5_000)),
    "dots": "name: ab\nsweep:\n  ? " + ".".join("a" * 5000) + "\n  : [1]\n",
}
"""Files that a reader without limits takes seconds or gigabytes for, or ends with a traceback."""
