"""A campaign for an examination: nothing in names, order or notes tells what is hidden in which specimen.

Belongs here: how names are taken away. What is hidden stands with the truth, under the new names.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.simulate.plan import Campaign


def hide_names(campaign: Campaign, seed: int) -> Campaign:
    """The same tests on the same films, under names that are drawn, with other noise.

    Parameters
    ----------
    campaign : what is to be simulated
    seed : of the names and of the noise

    Returns
    -------
    The campaign with specimens `S-01`, `S-02`, …, recordings numbered within each, a folder for each specimen, and no notes
    """
    order = np.random.default_rng(seed).permutation(len(campaign.specimens))
    names = {old: f"S-{place + 1:02d}" for old, place in zip(campaign.specimens, order, strict=True)}
    specimens = {names[old]: replace(specimen, name=names[old]) for old, specimen in campaign.specimens.items()}
    counts: dict[str, int] = {}
    renamed: dict[str, str] = {}
    planned = []
    for one in campaign.planned:
        name = f"{one.rig.name}-clamp" if one.specimen is None else names[one.specimen.name]
        counts[name] = counts.get(name, 0) + 1
        recording_id = f"{name}-{counts[name]:03d}-{one.procedure.protocol}"
        renamed[one.recording_id] = recording_id
        specimen = None if one.specimen is None else specimens[name]
        label = None if one.label is None else specimens[names[one.label.name]]
        folder = name if label is None else label.name
        planned.append(
            replace(one, recording_id=recording_id, folder=folder, specimen=specimen, label=label, notes=None)
        )
    mishaps = tuple(
        replace(m, recording=renamed[m.recording], specimen=names.get(m.specimen, m.specimen)) for m in campaign.mishaps
    )
    return replace(
        campaign, name="blind", seed=seed, operator=None, specimens=specimens, planned=tuple(planned), mishaps=mishaps
    )
