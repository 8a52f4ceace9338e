"""Ground truth stays with those who may serve it, made or as rows."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from unit.ports.test_sample_batch import SAMPLES, batch

from uwserver.ports import Event, Sample
from uwserver.ports.sample_batch import SampleBatch
from uwserver.server.without_truth import WithoutTruth
from uwserver.testing import FakeContext

TRUE = Sample("rov/truth/pose", 1, 0, 0, True, (1.0,))


class Hears:
    def __init__(self) -> None:
        self.samples: list[Sample] = []

    def put_samples(self, samples: Sequence[Sample]) -> None:
        self.samples += samples

    def put_event(self, event: Event) -> None: ...


class HearsRows(Hears):
    def __init__(self) -> None:
        super().__init__()
        self.batch: list[SampleBatch] = []

    def put_batch(self, batch: SampleBatch) -> None:
        self.batch.append(batch)


def test_samples_of_truth_are_left_out():
    reader = Hears()
    keeper = WithoutTruth(reader, FakeContext())
    keeper.put_samples([TRUE, SAMPLES[0]])
    assert reader.samples == SAMPLES[:1]
    assert keeper.put_batch is None, "it takes no rows"


@pytest.mark.parametrize("name", ["rov/state", "rov/truth/state"])
def test_rows_are_passed_on_where_none_of_them_is_truth(name: str):
    reader, rows = HearsRows(), batch()
    rows = SampleBatch({**rows.origins, 9: rows.origins[9]._replace(path=name)}, rows.log, 2, 5)
    keeper = WithoutTruth(reader, FakeContext())
    assert keeper.put_batch is not None
    keeper.put_batch(rows)
    is_true = name != "rov/state"
    assert reader.batch == ([] if is_true else [rows])
    assert reader.samples == ([SAMPLES[0], SAMPLES[2]] if is_true else [])
