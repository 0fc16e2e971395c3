"""What the study of detection says of first declarations."""

import torch

from studies.detection_report import Detections


def test_median_of_the_first_declaration():
    """Of an even number the later one; None where half of the sequences or more never declare."""
    first = torch.tensor([[3.0, 5.0, 9.0, torch.inf], [2.0, torch.inf, torch.inf, 7.0], [1.0, 1.0, 4.0, 6.0]])
    assert Detections(first, 0, 1.0).median_first() == [9.0, None, 4.0]
