"""Whether what was measured beside the drive holds between two samples, as a load that is switched, or is a line."""

from dataclasses import replace

import torch

from bench.diagnose.logs.noise import Noise
from bench.diagnose.logs.subject import Subject
from bench.diagnose.select.search import Search
from bench.diagnose.select.step import settled
from bench.diagnose.select.timing.sentences import held_said


def disturbances_read(subject: Subject, noise: Noise) -> Subject:
    """The subject with each of its model's disturbances held between samples where recordings say that it is.

    Straight lines are kept unless the model, its constants fitted, leaves less of what is whitened alike with it held.
    """
    search = Search(subject, (), lambda what: None, noise)
    with torch.no_grad():
        view, read = settled(search, replace(subject.model, held_extras=()))
        least = search.loss(view, read)
        for name in subject.model.disturbances:
            _, other = settled(search, replace(read, held_extras=(*read.held_extras, name)))
            loss = search.loss(view, other)
            if loss < least:
                read, least = other, loss
    held = read.held_extras
    notes = (*subject.notes, held_said(held)) if held else subject.notes
    return replace(subject, model=replace(subject.model, held_extras=held), notes=notes)
