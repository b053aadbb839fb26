"""Exports GroundingDINO and SAM 2.1 from a local Hugging Face folder to a bundle that `pgsag mask` can run.

    python tools/export_models.py detector  path/to/grounding-dino-tiny -o models/grounding-dino-tiny
    python tools/export_models.py segmenter path/to/sam2.1-hiera-small  -o models/sam2.1-hiera-small

Needs torch, transformers, onnx and onnxruntime (`pip install torch transformers onnx onnxruntime`). The folder holds
config.json, model.safetensors and, for the detector, tokenizer.json. Nothing is downloaded. The graphs are compared with
PyTorch at two sizes and two text lengths before the bundle is written; a difference ends the export.
"""

import argparse
import contextlib
import hashlib
import json
import os
import pathlib
import sys

os.environ.setdefault("HF_HUB_OFFLINE", "1")

import numpy as np
import onnxruntime
import torch
import transformers
from torch.nn import functional
from transformers.models.grounding_dino import modeling_grounding_dino as dino
from transformers.models.swin import modeling_swin as swin

VERSION = 1
OPSET = 17
MEAN = [0.485, 0.456, 0.406]
STD = [0.229, 0.224, 0.225]
# Largest differences to PyTorch that an export may show, relative to the largest value.
TOLERANCE = 1e-4


# ---------------------------------------------------------------------------------------------------------------------
# GroundingDINO: five patches, each for something that tracing cannot carry into ONNX.


def text_masks(input_ids, special_tokens):
    """Patch 1: which tokens attend to one another, by comparisons; `isin` and `cummax` have no ONNX operator."""
    count = input_ids.shape[1]
    at = torch.arange(count, device=input_ids.device)
    special = (input_ids[:, :, None] == special_tokens.to(input_ids.device)[None, None, :]).to(torch.int64).amax(-1)
    # The special token before each place (-1 where there is none), and the next one from it on (`count` likewise).
    before = torch.where((special[:, None, :] > 0) & (at[None, :] < at[:, None])[None], at[None, None, :], -1).amax(-1)
    after = torch.where((special[:, None, :] > 0) & (at[None, :] >= at[:, None])[None], at[None, None, :], count).amin(-1)
    valid = (after != 0) & (after != count - 1) & (after != count)
    together = (after[:, :, None] == after[:, None, :]) & valid[:, None, :]
    attention = together | (at[:, None] == at[None, :])[None]
    position = torch.where(valid, at[None] - before - 1, torch.zeros_like(after)).clamp(min=0).to(torch.long)
    return attention, position


def contrastive_forward(self, vision_hidden_state, text_hidden_state, text_token_mask):
    """Patch 2: padding with -inf instead of writing into a slice."""
    output = vision_hidden_state @ text_hidden_state.transpose(-1, -2)
    output = output.masked_fill(~text_token_mask[:, None, :], float("-inf"))
    return functional.pad(output, (0, self.max_text_len - output.shape[-1]), value=float("-inf"))


def step_linspace(start, end, steps, dtype=None, device=None, **_):
    """Patch 3: steps of one, as a range in 32 bits; traced `linspace` is computed in 64, which GridSample refuses."""
    return torch.arange(steps, device=device).to(dtype) + start


def traced_as_tensor(real):
    """Patch 4: the sizes of the levels stay part of the graph; as constants, every other image size is wrong."""

    def as_tensor(values, *arguments, **named):
        is_sizes = isinstance(values, list) and values and isinstance(values[0], tuple)
        if is_sizes and torch.is_tensor(values[0][0]):
            return torch.stack([torch.stack([h.long(), w.long()]) for h, w in values])
        return real(values, *arguments, **named)

    return as_tensor


def pad_to_even(self, features, height, width):
    """Patch 5: padding of nothing where nothing is missing; traced, the question whether to pad is answered once for all."""
    return functional.pad(features, (0, 0, 0, width % 2, 0, height % 2))


def pad_to_patches(self, pixels, height, width):
    """Patch 5, at the entrance."""
    high, wide = self.patch_size
    return functional.pad(pixels, (0, (wide - width % wide) % wide, 0, (high - height % high) % high))


@contextlib.contextmanager
def patched_dino(with_sizes=True):
    """The five patches, for as long as the block lasts."""
    kept = (
        dino.generate_masks_with_special_tokens_and_transfer_map,
        dino.GroundingDinoContrastiveEmbedding.forward,
        torch.linspace,
        torch.as_tensor,
        swin.SwinPatchMerging.maybe_pad,
        swin.SwinPatchEmbeddings.maybe_pad,
    )
    dino.generate_masks_with_special_tokens_and_transfer_map = text_masks
    dino.GroundingDinoContrastiveEmbedding.forward = contrastive_forward
    torch.linspace = step_linspace
    swin.SwinPatchMerging.maybe_pad, swin.SwinPatchEmbeddings.maybe_pad = pad_to_even, pad_to_patches
    if with_sizes:
        torch.as_tensor = traced_as_tensor(torch.as_tensor)
    try:
        yield
    finally:
        dino.generate_masks_with_special_tokens_and_transfer_map = kept[0]
        dino.GroundingDinoContrastiveEmbedding.forward = kept[1]
        torch.linspace, torch.as_tensor = kept[2], kept[3]
        swin.SwinPatchMerging.maybe_pad, swin.SwinPatchEmbeddings.maybe_pad = kept[4], kept[5]


DETECTOR_INPUTS = ["pixel_values", "input_ids", "token_type_ids", "attention_mask", "pixel_mask"]


class Detector(torch.nn.Module):
    def __init__(self, model):
        super().__init__()
        self.model = model

    def forward(self, pixel_values, input_ids, token_type_ids, attention_mask, pixel_mask):
        found = self.model(
            pixel_values=pixel_values,
            input_ids=input_ids,
            token_type_ids=token_type_ids,
            attention_mask=attention_mask,
            pixel_mask=pixel_mask,
        )
        return found.logits, found.pred_boxes


def test_picture(seed, width, height):
    """A picture that every language makes alike: whole numbers only. [3, height, width], 0 to 255."""
    y, x = np.mgrid[0:height, 0:width].astype(np.int64)
    planes = [(x * (7 + c) + y * (13 + 2 * c) + (x * y * (seed + c)) // 61 + 40 * ((x // 19 + y // 23) % 3)) % 256 for c in range(3)]
    return np.stack(planes).astype(np.uint8)


def normalised(picture):
    """As the networks want it. [1, 3, height, width] float32"""
    mean, std = (np.array(v, np.float32)[:, None, None] for v in (MEAN, STD))
    return torch.from_numpy(((picture.astype(np.float32) / np.float32(255)) - mean) / std)[None]


def detector_inputs(seed, width, height, ids):
    ids = torch.tensor([ids])
    return (
        normalised(test_picture(seed, width, height)),
        ids,
        torch.zeros_like(ids),
        torch.ones_like(ids),
        torch.ones((1, height, width), dtype=torch.long),
    )


def export_detector(model, path, size, ids, with_sizes=True):
    """Writes the graph; `size` and `ids` are what it is traced with."""
    open_axes = {
        "pixel_values": {0: "batch", 2: "height", 3: "width"},
        "input_ids": {0: "batch", 1: "tokens"},
        "token_type_ids": {0: "batch", 1: "tokens"},
        "attention_mask": {0: "batch", 1: "tokens"},
        "pixel_mask": {0: "batch", 1: "height", 2: "width"},
        "logits": {0: "batch"},
        "pred_boxes": {0: "batch"},
    }
    with patched_dino(with_sizes), torch.no_grad():
        torch.onnx.export(
            Detector(model).eval(),
            detector_inputs(1, *size, ids),
            str(path),
            input_names=DETECTOR_INPUTS,
            output_names=["logits", "pred_boxes"],
            dynamic_axes=open_axes,
            opset_version=OPSET,
            dynamo=False,
        )


def must_pad(model, size):
    """Swin cuts its padding off again only where there was some, and tracing keeps the answer: trace where there is."""
    window = model.config.backbone_config.window_size
    sides = [-(-side // 4) for side in size]
    for _ in range(4):
        if all(side % window == 0 for side in sides):
            sys.exit(f"trace at another size than {size}: a map of {sides} needs no padding to windows of {window}")
        sides = [-(-side // 2) for side in sides]


def detector_cases(model, path, sizes, texts):
    """Compares graph and PyTorch; the cases of the bundle's self-test."""
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    cases = []
    for seed, (size, ids) in enumerate(zip(sizes, texts), start=1):
        inputs = detector_inputs(seed, *size, ids)
        with torch.no_grad():
            logits, boxes = Detector(model).eval()(*inputs)
        got = session.run(None, {name: value.numpy() for name, value in zip(DETECTOR_INPUTS, inputs)})
        best = logits[0].max(-1).values.numpy()
        missed = unmatched(boxes[0].numpy(), best, got[1][0], got[0][0].max(-1))
        print(f"  {size[0]} x {size[1]}, {len(ids)} tokens: {missed} of {len(best)} rows differ")
        if missed > len(best) // 100:
            sys.exit(f"the graph differs from PyTorch at {size}: not written")
        cases.append({
            "seed": seed, "width": size[0], "height": size[1], "ids": ids,
            "boxes": rounded(boxes[0].numpy()), "scores": rounded(best),
        })
    return cases


def unmatched(boxes, scores, got_boxes, got_scores):
    """Rows without a partner: rows of nearly equal rank may trade places, so the two are compared as sets."""
    scale = max(1.0, float(np.abs(scores).max()))
    near = np.abs(boxes[:, None] - got_boxes[None]).max(-1) <= TOLERANCE
    alike = np.abs(scores[:, None] - got_scores[None]) <= 1e-2 * scale
    return int((~(near & alike).any(1)).sum())


# ---------------------------------------------------------------------------------------------------------------------
# SAM 2.1: an encoder with its position embedding folded, and a decoder that gives all four masks.


class Encoder(torch.nn.Module):
    def __init__(self, model):
        super().__init__()
        self.model = model
        backbone = model.vision_encoder.backbone
        size = model.config.prompt_encoder_config.image_size
        with torch.no_grad():
            places = backbone.patch_embed(torch.zeros(1, 3, size, size)).shape[1:3]
            folded = backbone._get_pos_embed(tuple(places)).clone()
        # A cubic resize of a constant is a constant; left in the graph, some runtimes compute it as linear.
        backbone._get_pos_embed = lambda _: folded

    def forward(self, pixel_values):
        return tuple(self.model.get_image_embeddings(pixel_values))


class Decoder(torch.nn.Module):
    """Points and labels in, the masks of all four tokens out. A box is two points with labels 2 and 3."""

    def __init__(self, model):
        super().__init__()
        self.model = model
        self.register_buffer("place", model.get_image_wide_positional_embeddings().detach())
        # All four come from one pass; the choice among them is taken out where it would be made.
        model.mask_decoder.dynamic_multimask_via_stability = True
        model.mask_decoder._dynamic_multimask_via_stability = lambda masks, scores: (masks, scores)

    def forward(self, input_points, input_labels, low, middle, high):
        sparse, dense = self.model.prompt_encoder(input_points, input_labels, None, None)
        masks, scores, _, objectness = self.model.mask_decoder(high, self.place, sparse, dense, False, [low, middle])
        return masks, scores, objectness


def prompts(size):
    """Two prompts of two points: a box, and a point beside another that it is not."""
    points = [[[0.2, 0.3], [0.7, 0.8]], [[0.5, 0.5], [0.1, 0.9]]]
    return torch.tensor([points], dtype=torch.float32) * size, torch.tensor([[[2, 3], [1, 0]]])


LEVELS = ["image_embeddings.0", "image_embeddings.1", "image_embeddings.2"]


def export_segmenter(model, folder):
    """Writes encoder.onnx and decoder.onnx; the cases of the bundle's self-test."""
    size = model.config.prompt_encoder_config.image_size
    encoder, decoder = Encoder(model).eval(), Decoder(model).eval()
    pixels = normalised(test_picture(1, size, size))
    with torch.no_grad():
        levels = encoder(pixels)
        torch.onnx.export(
            encoder, (pixels,), str(folder / "encoder.onnx"), input_names=["pixel_values"], output_names=LEVELS,
            dynamic_axes={name: {0: "batch"} for name in ["pixel_values", *LEVELS]}, opset_version=OPSET, dynamo=False,
        )
        torch.onnx.export(
            decoder, (*prompts(size), *levels), str(folder / "decoder.onnx"),
            input_names=["input_points", "input_labels", *LEVELS],
            output_names=["pred_masks", "iou_scores", "object_score_logits"],
            dynamic_axes={
                "input_points": {1: "prompts", 2: "points"}, "input_labels": {1: "prompts", 2: "points"},
                "pred_masks": {1: "prompts"}, "iou_scores": {1: "prompts"}, "object_score_logits": {1: "prompts"},
            },
            opset_version=OPSET, dynamo=False,
        )
    return segmenter_cases(encoder, decoder, folder, size)


def segmenter_cases(encoder, decoder, folder, size):
    run = [onnxruntime.InferenceSession(str(folder / name), providers=["CPUExecutionProvider"]) for name in ("encoder.onnx", "decoder.onnx")]
    cases = []
    for seed in (1, 2):
        pixels = normalised(test_picture(seed, size, size))
        points, labels = prompts(size)
        with torch.no_grad():
            levels = encoder(pixels)
            masks, scores, _ = decoder(points, labels, *levels)
        got = run[0].run(None, {"pixel_values": pixels.numpy()})
        fed = dict(zip(LEVELS, got), input_points=points.numpy(), input_labels=labels.numpy())
        got_masks, got_scores, _ = run[1].run(None, fed)
        worst = max(relative(a.numpy(), b) for a, b in [*zip(levels, got), (masks, got_masks), (scores, got_scores)])
        print(f"  picture {seed}: relative difference {worst:.1e}")
        if worst > TOLERANCE:
            sys.exit("the graphs differ from PyTorch: not written")
        step = max(1, masks.shape[-1] // 16)
        cases.append({
            "seed": seed, "width": size, "height": size, "points": points[0].tolist(), "labels": labels[0].tolist(),
            "masks": rounded(masks[0, :, :, ::step, ::step].numpy()), "mask_step": step, "scores": rounded(scores[0].numpy()),
            "largest": float(masks.abs().max()),
        })
    return cases


def relative(wanted, got):
    return float(np.abs(wanted - got).max() / max(1e-12, np.abs(wanted).max()))


# ---------------------------------------------------------------------------------------------------------------------
# The bundle.


def rounded(values):
    """Seven digits, without the noise behind them; -inf has no place in JSON."""
    return [rounded(value) for value in values] if np.ndim(values) else float(f"{max(float(values), -1e30):.8g}")


def write_bundle(folder, kind, roles, image, text, source, cases, licence="Apache-2.0"):
    """manifest.toml and selftest.json beside the graphs."""
    (folder / "selftest.json").write_text(json.dumps({"cases": cases}))
    lines = [
        f'name = "{folder.name}"', f'kind = "{kind}"', f'licence = "{licence}"', f'source = "{source}"',
        f'exporter = "export_models.py {VERSION}, torch {torch.__version__}, transformers {transformers.__version__}, opset {OPSET}"',
        "", "[image]", *(f"{key} = {value}" for key, value in image.items()), f"mean = {MEAN}", f"std = {STD}",
    ]
    if text:
        lines += ["", "[text]", *(f"{key} = {value}" for key, value in text.items())]
    for role, name in [*roles.items(), ("selftest", "selftest.json")]:
        content = (folder / name).read_bytes()
        lines += ["", "[[files]]", f'role = "{role}"', f'name = "{name}"', f"bytes = {len(content)}", f'sha256 = "{hashlib.sha256(content).hexdigest()}"']
    (folder / "manifest.toml").write_text("\n".join(lines) + "\n")
    print(f"wrote {folder}")


def detector_bundle(source, folder, sizes=((448, 320), (331, 502)), shortest=800, longest=1333, model=None):
    """A bundle of GroundingDINO, tiny or base."""
    source, folder = pathlib.Path(source), pathlib.Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    model = model or transformers.GroundingDinoForObjectDetection.from_pretrained(source)
    model = model.eval()
    model.config.disable_custom_kernels = True
    tokenizer = json.loads((source / "tokenizer.json").read_text())
    ids = [text_ids(tokenizer, text) for text in ("buildings .", "a red roof . small houses . trees .")]
    must_pad(model, sizes[0])
    export_detector(model, folder / "detector.onnx", sizes[0], ids[0])
    cases = detector_cases(model, folder / "detector.onnx", sizes, ids)
    (folder / "tokenizer.json").write_text((source / "tokenizer.json").read_text())
    image = {"shortest": shortest, "longest": longest}
    roles = {"detector": "detector.onnx", "tokenizer": "tokenizer.json"}
    write_bundle(folder, "detector", roles, image, {"longest": model.config.max_text_len}, source.name, cases)


def text_ids(tokenizer, text):
    """Numbers of words that the vocabulary holds whole; enough for a self-test."""
    vocabulary = tokenizer["model"]["vocab"]
    return [vocabulary["[CLS]"], *(vocabulary[word] for word in text.split() if word in vocabulary), vocabulary["[SEP]"]]


def segmenter_bundle(source, folder, model=None):
    """A bundle of SAM 2.1, any size."""
    source, folder = pathlib.Path(source), pathlib.Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    model = model or transformers.Sam2Model.from_pretrained(source)
    size = model.config.prompt_encoder_config.image_size
    cases = export_segmenter(model.eval(), folder)
    roles = {"encoder": "encoder.onnx", "decoder": "decoder.onnx"}
    write_bundle(folder, "segmenter", roles, {"square": size}, None, source.name, cases)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("kind", choices=["detector", "segmenter"])
    parser.add_argument("source", help="a Hugging Face folder on this machine")
    parser.add_argument("-o", "--output", required=True, help="the bundle's folder")
    typed = parser.parse_args()
    {"detector": detector_bundle, "segmenter": segmenter_bundle}[typed.kind](typed.source, typed.output)


if __name__ == "__main__":
    main()
