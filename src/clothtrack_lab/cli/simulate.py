"""The verbs of the simulated environment: simulate and bench."""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from clothtrack.cli.options import (
    AsJson,
    Ray,
    Seed,
    Settings,
)
from clothtrack.cli.terminal import complain, progress, say_result
from clothtrack_lab.extra import require_lab


def simulate(
    output: Positional[Path],
    *,
    garment: Annotated[Literal["towel", "tshirt", "trousers"], arg(aliases=["--kind"])] = "towel",
    template: Path | None = None,
    garment_seed: int | None = None,
    states: int | None = None,
    trajectories: int | None = None,
    actions: int | None = None,
    settings: Settings = (),
    workers: int = 1,
    ray: Ray = "",
    seed: Seed = 0,
    json: AsJson = False,
) -> int:
    """Record in a simulated world; or, with --states, crumple garments for a network to learn from.

    Args:
        output: folder for recordings/ and truth/, or shards/; what is finished there is kept.
        garment: what lies on the table; trousers only with --states.
        template: the garment's own mesh (`clothtrack garment`), of one layer for a towel, of two
            for a tshirt.
        garment_seed: one garment for all recordings, before one camera, of a cut, size and
            thickness that no shipped network was trained on; its recordings are KIND_gNNNN_SEED.
        states: record nothing; make at least so many labelled states with our own solver.
        trajectories: how many recordings, 1 by default; they get the seeds SEED, SEED + 1, ...
        actions: pick-and-places per recording, 3 by default.
        settings: changes to what is recorded, such as sensor.width=320 or vertex_count=300.
        workers: processes.
        ray: address of Ray, which is to do it.
        seed: of garment, pose, actions, camera and noise.
        json: machine-readable.
    """
    if states is not None:
        from clothtrack.files.settings import with_settings
        from clothtrack.reconstruction.data.states import StatesConfig, generate_states

        if template is not None or garment_seed is not None:
            given = "--template" if template is not None else "--garment-seed"
            complain(f"--states draws garments of many cuts; leave {given} out")
            return 2
        if trajectories is not None or actions is not None:
            complain(
                "--states records nothing, so that --trajectories and --actions mean nothing; "
                "leave them out, or --states"
            )
            return 2
        recipe = with_settings(StatesConfig(), settings)
        store = generate_states(
            output, garment, states, seed=seed, config=recipe, processes=workers,
            progress=progress, ray=ray,
        )  # fmt: skip
        report = {"states": store.folder, "card": store.folder / "README.md"}
        report["garments"] = len(store.shards)
        say_result("{card}   ({garments} garments)".format(**report), report, json=json)
        return 0
    if garment == "trousers":
        complain("trousers are not recorded; add --states, or give a towel or a tshirt")
        return 2
    count = 1 if trajectories is None else trajectories
    if actions is not None:
        settings = (f"actions={actions}", *settings)
    require_lab()
    from clothtrack_lab.flattening import simulate as record

    folders = record(
        output, garment, count, seed=seed, template=template, garment_seed=garment_seed,
        settings=settings, workers=workers, progress=progress, ray=ray,
    )  # fmt: skip
    say_result("\n".join(map(str, folders)), folders, json=json)
    return 0 if len(folders) == count else 1


def bench(
    output: Positional[Path],
    *,
    split: Literal["all", "dev", "test", "hard"] = "all",
    printed: Annotated[bool, arg(name="print")] = False,
    verify: bool = False,
    workers: int = 1,
    ray: Ray = "",
    json: AsJson = False,
) -> int:
    """Record the benchmark: 20 trajectories to tune on (dev), 30 to score (test), 10 hard ones.

    Args:
        output: folder for recordings/, truth/ and their list; finished trajectories are kept.
        split: only this part.
        printed: the same with a print on the cloth, in a folder of its own.
        verify: record nothing; check what is there against its checksums.
        workers: processes.
        ray: address of Ray, which is to do it.
        json: machine-readable.
    """
    require_lab()
    from clothtrack_lab.world import bench as contents
    from clothtrack_lab.world import bench_generation as generation

    splits = contents.SPLITS if split == "all" else (split,)
    listed = contents.trajectories(splits, printed=printed)
    if verify:
        for line in (wrong := generation.verify_bench(output, listed)):
            complain(line)
        text = f"{len(listed) - len(wrong)} of {len(listed)} trajectories are as listed"
        say_result(text, {"trajectories": len(listed), "wrong": wrong}, json=json)
        return 1 if wrong else 0
    entries = generation.generate_bench(
        output, listed, processes=workers, progress=progress, ray=ray
    )
    say_result(generation.table(entries), entries, json=json)
    return 0
