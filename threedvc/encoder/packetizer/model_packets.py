# SPDX-License-Identifier: MIT
"""Packets of models: objects that begin, their cells, relief, texture and light."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from threedvc.coding.light import pack_light
from threedvc.coding.relief import encode_relief
from threedvc.coding.texture import encode_texture
from threedvc.coding.update import encode_update_with_result
from threedvc.config import EncoderConfig
from threedvc.encoder.appearance.appearance_fit import FittedAppearance
from threedvc.encoder.appearance.background.background_depth import RELIEF_BITS
from threedvc.encoder.appearance.lighting import light_at
from threedvc.encoder.fusion.surface_extraction import Surface, extract_surface, grouped_by_region
from threedvc.encoder.packetizer.background_choice import BackgroundChoice
from threedvc.encoder.packetizer.scene_source import BatchFrames, SceneSource
from threedvc.encoder.packetizer.sent_state import SentObject
from threedvc.encoder.rate.model_updates import first_visible_update, incremental_update
from threedvc.encoder.rate.region_of_interest import object_weight, with_roi_weights, with_steps_scaled
from threedvc.encoder.rate.trial_coding import color_settings
from threedvc.encoder.rate.update_priority import select_within, sight_weights
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate
from threedvc.stream.framing_sizes import MAX_MEMBER_FRAMING_BYTES
from threedvc.stream.headers import DepthHeader, LightHeader, ModelHeader, ObjectHeader, ReliefHeader, TextureHeader
from threedvc.stream.packets import Packet

__all__ = ["ModelPackets"]

MIN_LIVE_CELLS = 4
"""A live encoder lets fewer changed cells than these wait for more: their framing would outweigh them."""
BUDGET_SHARE = 0.97
"""How much of the budget a part of an update aims at: what parts take is estimated, and a second trial costs time."""


class ModelPackets:
    """Writes what the decoder lacks of models.

    Parameters
    ----------
    scene
        The scene.
    config
        Choices.
    finished
        What the fit to the pictures found; None: the mean colors of the evidence.
    background
        How the stream shows the background.
    colored
        Whether cells of evidence have its colors; else a video shows them.
    """

    def __init__(
        self,
        scene: SceneSource,
        config: EncoderConfig,
        fitted: FittedAppearance | None,
        background: BackgroundChoice,
        *,
        colored: bool = True,
    ) -> None:
        self._scene, self._config, self._colored = scene, config, colored
        self._fitted, self._background = fitted, background
        self._color = color_settings(config.color, scene.info.gray)
        # Number of the object of completed surfaces, and the edge of its cells in meters.
        self._completed = {} if fitted is None or fitted.inferred is None else dict([fitted.inferred])
        self._surfaces: dict[int, Surface] = {}

    def numbers(self) -> list[int]:
        """Return the numbers of all objects so far, those of completed surfaces among them."""
        return sorted({*self._scene.objects, *self._completed})

    def born(self, number: int) -> int | None:
        """Return the first frame that shows an object; None if no frame has so far."""
        if self._fitted is not None and number in self._completed:
            return int(self._fitted.surfaces[number].first_seen.min())
        return self._scene.objects[number].born

    def new_model(self, number: int) -> DecodedModel:
        """Return the model of an object of which nothing has been sent."""
        appearance = self._config.appearance
        if number in self._completed:
            return DecodedModel(self._completed[number], guessed=True)
        if number == 0 and self._background.depth_map is not None:
            return DecodedModel(self._background.depth_map.voxel_size_m, relief_bits=RELIEF_BITS)
        relief_bits = 0 if self._fitted is None else appearance.relief_bits or 0
        scale = 1 if self._fitted is None or self._fitted.colorless else appearance.texture_scale
        item = self._scene.objects[number]
        return DecodedModel(item.evidence.voxel_size_m, scale, relief_bits=relief_bits, passing=item.passing)

    def introduction(self, sent: SentObject) -> Packet:
        """Return the packet by which an object begins."""
        model = sent.model
        return ObjectHeader(
            object_id=sent.number,
            voxel_size_m=model.voxel_size_m,
            texture_bits=0 if model.texture is None else model.texture.scale.bit_length() - 1,
            guessed=model.guessed,
            relief_bits=model.relief_bits,
            passing=model.passing,
        ).packet()

    def lights(self, number: int, batch: BatchFrames, *, new: bool) -> Iterator[Packet]:
        """Yield the lights on an object that begin in a batch, and the present one if the object is new."""
        script = () if self._fitted is None else self._fitted.colors.lights.get(number, ())
        if script and new:
            yield LightHeader(object_id=number, frame=batch.first).packet(pack_light(light_at(script, batch.first)))
        for frame, factors in script[1:]:
            if batch.first + new <= frame < batch.stop:
                yield LightHeader(object_id=number, frame=frame).packet(pack_light(factors))

    def update(self, sent: SentObject, batch: BatchFrames, budget_bytes: float, *, last: bool) -> Iterator[Packet]:
        """Yield the model update of an object and relief and texture of its new cells, or the map that makes cells.

        The poses of the object in the batch must be coded: they tell where the depth map was taken.

        Parameters
        ----------
        sent
            What the decoder has of the object.
        batch
            The frames.
        budget_bytes
            What the packets may take.
        last
            Whether no frame follows: all cells are due then.
        """
        if sent.number == 0 and self._background.depth_map is not None:
            if not sent.model.cell_count:
                sent.model = self._background.depth_map.model(self._scene.info.rig.depth, sent.run_start)
                yield DepthHeader(frame=batch.first).packet(self._background.depth_map.payload)
            return
        update = self._due(sent, None if last else batch.stop)
        if update.size < (MIN_LIVE_CELLS if self._config.causal and not last else 1):
            return
        update, payload, decoded = self._encode_within(update, sent, batch, budget_bytes - MAX_MEMBER_FRAMING_BYTES)
        if update.empty:
            return
        sent.model.apply(decoded)
        sent.unquantized.apply(update)
        yield ModelHeader(object_id=sent.number, frame=batch.first).packet(payload)
        yield from self._relief(sent, batch.first)
        yield from self._texture(sent, batch.first)

    def _due(self, sent: SentObject, until_frame: int | None) -> ModelUpdate:
        """Return what is to be sent of an object, as a live encoder knows it, or as the finished surface has it."""
        if self._config.causal:
            evidence = self._scene.objects[sent.number].evidence
            return incremental_update(evidence, sent.unquantized, self._config.threads, colored=self._colored)
        return first_visible_update(self._surface(sent), sent.model, until_frame)

    def _surface(self, sent: SentObject) -> Surface:
        """Return the finished surface of an object, read when it is first asked for."""
        if sent.number not in self._surfaces:
            surface = self._read_surface(sent.number)
            self._surfaces[sent.number] = surface if sent.model.guessed else grouped_by_region(surface)
        return self._surfaces[sent.number]

    def _read_surface(self, number: int) -> Surface:
        if self._fitted is None:
            return extract_surface(self._scene.objects[number].evidence, self._config.threads, smooth=True)
        surface = self._fitted.surfaces[number]
        if number == 0 and self._background.image is not None:
            return replace(surface, colors=np.zeros_like(surface.colors))
        return surface

    def _encode_within(
        self, update: ModelUpdate, sent: SentObject, batch: BatchFrames, budget_bytes: float
    ) -> tuple[ModelUpdate, bytes, ModelUpdate]:
        """Encode as much of an update as a budget allows, what gains most information per bit first; the rest waits.

        Returns the part that is sent, its payload, and that part as decoded.
        """
        payload, decoded = self._encode(update, sent)
        while len(payload) > budget_bytes and not update.empty:
            share = BUDGET_SHARE * budget_bytes / len(payload)
            item = self._scene.objects[sent.number]
            sight = sight_weights(item.evidence, item.in_sight, item.poses[batch.stop - 1])
            update = select_within(update, item.evidence, sent.unquantized, share, sight, colored=self._colored)
            payload, decoded = self._encode(update, sent)
        return update, payload, decoded

    def _encode(self, update: ModelUpdate, sent: SentObject) -> tuple[bytes, ModelUpdate]:
        # Completed surfaces belong to the background, whatever their number.
        number = 0 if sent.model.guessed else sent.number
        weighted, settings = with_roi_weights(update, self._color, self._config.focus, number, sent.model.voxel_size_m)
        return encode_update_with_result(weighted, *sent.model.cells(), settings)

    def _relief(self, sent: SentObject, frame: int) -> Iterator[Packet]:
        """Yield where in the cells that were just sent the surface passes."""
        if not sent.model.relief_bits:
            return
        subvoxel_offsets = self._surface(sent).offsets_at(sent.model.cells_without_offset()[0])
        if len(subvoxel_offsets):
            payload = encode_relief(sent.model, subvoxel_offsets)
            yield ReliefHeader(object_id=sent.number, frame=frame).packet(payload)

    def _texture(self, sent: SentObject, frame: int) -> Iterator[Packet]:
        """Yield the colors of the texels of cells that were just sent."""
        if self._fitted is None or sent.model.texture is None:
            return
        texels = sent.model.uncolored_texels()
        if not len(texels):
            return
        owners = sent.model.index.locate(texels // sent.model.texture.scale)
        colors = self._fitted.colors.texel_colors(sent.number, texels, sent.model.color.reshape(-1, 3)[owners])
        settings = with_steps_scaled(self._color, object_weight(self._config.focus, sent.number))
        payload, decoded = encode_texture(sent.model, texels, colors, settings)
        sent.model.texture.paint(texels, decoded)
        yield TextureHeader(object_id=sent.number, frame=frame).packet(payload)
