"""Which examples come when; and errors that cover what they claim."""

import numpy as np
import pytest
import torch
from toy import of_heights, of_images

from ninedtact.force.network_input import InputChannels
from ninedtact_train.training.examples import rows_of_batches
from ninedtact_train.training.trained_network import LAPLACE_QUANTILES, fit_error_scale_correction


def test_processes_share_an_epoch_and_every_epoch_is_shuffled_anew() -> None:
    rows, epochs = np.arange(100, 200), []
    for epoch in range(2):
        batches = [rows_of_batches(rows, 10, (3, epoch), rank, 2) for rank in (0, 1)]
        assert [len(own) for own in batches] == [5, 5]
        assert sorted(np.concatenate([*batches[0], *batches[1]]).tolist()) == rows.tolist()
        epochs.append(np.concatenate(batches[0]))
    assert not np.array_equal(*epochs)
    assert np.array_equal(np.concatenate(rows_of_batches(rows, 10, (3, 1), 0, 2)), epochs[1])


def test_all_rows_are_judged_and_only_whole_batches_are_learnt() -> None:
    rows = np.arange(25)
    assert np.concatenate(rows_of_batches(rows, 10, None)).tolist() == rows.tolist()
    assert [len(batch) for batch in rows_of_batches(rows, 10, (0, 0))] == [10, 10]
    assert [len(batch) for batch in rows_of_batches(rows[:4], 10, (0, 0))] == [4]


def test_a_batch_is_a_copy_and_carries_its_own_references() -> None:
    examples = of_images()
    batch = examples.batch(np.array([0, 3])).to_float()
    assert batch.references is not None
    assert batch.references[:, 0, 0].tolist() == [120, 150]
    batch.wrench[:] = 0
    assert examples.wrench[0].any()
    assert batch.network_input(InputChannels.DEFORMATION).shape == (2, 3, 16, 24)
    heights = of_heights().batch(np.array([0, 3])).to_float().network_input(InputChannels.HEIGHTS_AND_GEL)
    assert torch.equal(heights[:, 1], torch.ones(2, 16, 24))


@pytest.mark.parametrize("tail", ["normal", "laplace"])
def test_told_errors_cover_what_they_claim(tail: str) -> None:
    rng = np.random.default_rng(0)
    true_scale = np.exp(rng.normal(0, 1, (20000, 6)))
    off = np.abs(getattr(rng, tail)(0, 1, true_scale.shape) * true_scale)
    claimed = 3 * true_scale
    gain, power = fit_error_scale_correction(off[:10000], claimed[:10000])
    told = gain * claimed[10000:] ** power
    covered = [(off[10000:] <= half * told).mean(0) for half in LAPLACE_QUANTILES]
    assert np.abs(covered[0] - 0.5).max() < 0.03 and np.abs(covered[1] - 0.9).max() < 0.02
    if tail == "laplace":
        np.testing.assert_allclose(np.median(told / true_scale[10000:], axis=0), 1, rtol=0.05)
