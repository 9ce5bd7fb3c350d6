"""A process dies at any call that changes the disk (CR-2), or the machine loses power there (CR-3)."""

import random
import shutil

import pytest
from faults.disk import Death, Disk, Model, build, die_at
from faults.scenarios import EPOCHS, RESULTS, check_recovers, chosen, note, read, recorded

from wobblesim.study.store import SCRATCH


def test_death_at_any_call_loses_nothing_and_doubles_nothing(tmp_path, scenario, injected):  # CR-2
    folder = tmp_path / "dead"
    EPOCHS[0] = 0
    disk, wanted = recorded(scenario, tmp_path / "whole")
    epochs = EPOCHS[0]
    points = [number for number, call in enumerate(disk.tried, 1) if call.kind != "read"]
    before = read(tmp_path / "origin" / RESULTS)[1]
    for point in points:
        EPOCHS[0] = 0
        shutil.copytree(tmp_path / "origin", folder)
        with Disk(folder, die_at(point)) as dying, pytest.raises(Death):
            scenario.act(folder, lambda told: note(dying, folder, told))
        assert len(dying.tried) == point
        told = [call.more[0] for call in dying.calls if call.kind == "mark"]
        check_recovers(scenario, folder, wanted, before.union(*told))
        assert scenario.cost is None or EPOCHS[0] <= epochs + scenario.cost
        shutil.rmtree(folder)
    injected("process dies before a call that changes the disk, or half-way through a write", len(points))


# What becomes of changes that were not flushed: of names of a folder, and of bytes of a file.
LEFT = (
    (["none"], ["none"]),
    (["all"], ["none"]),  # names of empty files
    (["all"], ["zeros"]),
    (["all"], ["half"]),  # torn files
    (["none"], ["all"]),  # content without a name
)
ANYTHING = ["all", "none"], ["all", "half", "zeros", "none"]


def states(model, rng, mixed):
    """What a power cut may leave: all in one way or another, and mixtures by chance."""
    for names, of_bytes in [*LEFT, *[ANYTHING] * mixed]:
        choices = {"names": names, "bytes": of_bytes}
        yield model.left(lambda kind, choices=choices: rng.choice(choices[kind]))


def worth_a_look(left):
    """What a state is but for what the next process throws away unseen."""
    return frozenset(item for item in left.items() if f"/{SCRATCH}/" not in item[0])


def check_power_cuts(tmp_path, scenario, injected, mixed):
    seen, rng = set(), random.Random(3)
    disk, wanted = recorded(scenario, tmp_path / "whole")
    model, folder = Model(tmp_path / "origin"), tmp_path / "cut"
    there = read(tmp_path / "origin" / RESULTS)[1]
    for call in disk.calls:
        if call.kind == "mark":
            there = there.union(*call.more)
        model.play(call, tmp_path / "whole")
        for left in states(model, rng, mixed):
            state = hash(worth_a_look(left)), len(there)
            if state not in seen:
                seen.add(state)
                build(left, folder)
                check_recovers(scenario, folder, wanted, there)
                shutil.rmtree(folder)
    injected("power cut: what was not flushed is gone, or a part of it", len(seen))


@pytest.mark.parametrize("scenario", chosen("commit", "checkpoints", "take in shards", "recovery"), indirect=True)
def test_a_power_cut_at_any_call_leaves_no_wrong_row_and_loses_none(tmp_path, scenario, injected):  # CR-3
    check_power_cuts(tmp_path, scenario, injected, mixed=1)


@pytest.mark.nightly
def test_many_power_cuts(tmp_path, scenario, injected):  # CR-3
    check_power_cuts(tmp_path, scenario, injected, mixed=20)


def test_the_record_of_the_calls_is_the_folder(tmp_path, scenario):
    """Whatever else a process did to the disk would be missing from what power cuts leave."""
    shutil.copytree(tmp_path / "origin", tmp_path / "whole")
    with Disk(tmp_path / "whole") as disk:
        scenario.act(tmp_path / "whole", lambda _: None)
    model = Model(tmp_path / "origin")
    for call in disk.calls:
        model.play(call, tmp_path / "whole")
    left = model.left(lambda _: "all")
    paths = [tmp_path / "whole", *(tmp_path / "whole").rglob("*")]
    there = {
        str(path).removeprefix(str(tmp_path / "whole")): None if path.is_dir() else path.read_bytes() for path in paths
    }
    assert left == there
