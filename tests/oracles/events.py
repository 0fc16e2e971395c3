"""Event files read back, by TensorBoard's own reader."""

import io
import os

import matplotlib.image
import numpy as np
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar.layout_pb2 import Layout
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData


def read(directory: str | os.PathLike[str]) -> EventAccumulator:
    """All events of a folder; nothing is sampled."""
    everything = {"scalars": 0, "images": 0, "histograms": 0, "tensors": 0}
    return EventAccumulator(str(directory), size_guidance=everything).Reload()


def scalars(events: EventAccumulator, tag: str) -> list[tuple[int, float]]:
    """Steps and values under a tag."""
    return [(event.step, event.value) for event in events.Scalars(tag)]


def images(events: EventAccumulator, tag: str) -> dict[int, np.ndarray]:
    """Decoded images under a tag by their steps, `(height, width, channels)`."""
    return {
        event.step: matplotlib.image.imread(io.BytesIO(event.encoded_image_string), format="png")
        for event in events.Images(tag)
    }


def hparams(events: EventAccumulator) -> dict[str, float | str | bool]:
    """Settings in the row of this run."""
    content = events.summary_metadata["_hparams_/session_start_info"].plugin_data.content
    values = HParamsPluginData.FromString(content).session_start_info.hparams
    return {name: getattr(value, value.WhichOneof("kind")) for name, value in values.items()}


def metric_columns(events: EventAccumulator) -> set[str]:
    """Metrics that the table has columns for."""
    content = events.summary_metadata["_hparams_/experiment"].plugin_data.content
    return {info.name.tag for info in HParamsPluginData.FromString(content).experiment.metric_infos}


def layout(events: EventAccumulator) -> dict[str, dict[str, list[str]]]:
    """Charts of the custom scalars: tags by category and title."""
    *_, event = events.Tensors("custom_scalars__config__")  # a run that went on wrote it again
    return {
        category.title: {chart.title: list(chart.multiline.tag) for chart in category.chart}
        for category in Layout.FromString(event.tensor_proto.string_val[0]).category
    }
