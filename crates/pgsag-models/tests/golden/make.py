"""Makes everything in this folder: two tiny networks of the real architectures with random weights, exported by
tools/export_models.py, and what Python says of them. Run by hand; the tests read what it wrote.

    python crates/pgsag-models/tests/golden/make.py

torch 2.15.0, transformers 5.23.0, onnx 1.23.2, onnxruntime 1.31.1, tokenizers 0.23.3, pillow 13.0.0, pycocotools 2.0.11.
The pictures are `test_picture` of the exporter: whole numbers, made again in Rust.
"""

import json
import pathlib
import random
import sys

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[3] / "tools"))

import numpy as np
import onnx
import tokenizers
import torch
import transformers
from PIL import Image
from pycocotools import mask as coco
from torch.nn import functional
from transformers.models.grounding_dino import modeling_grounding_dino as dino
from transformers.models.sam2 import configuration_sam2 as sam2

import export_models as export

SEED = 7
SHORTEST, LONGEST = 96, 160
SQUARE = 128


# ---------------------------------------------------------------------------------------------------------------------
# Words.

WORDS = """building buildings roof roofs house houses tree trees road car cars small large red green tall a the of and with
on in near old new flat gable chimney window street city church tower garage shed water field photo drone above""".split()


def vocabulary():
    """1 100 pieces of our own, with the numbers that GroundingDINO's code knows by heart at their places."""
    fixed = {0: "[PAD]", 100: "[UNK]", 101: "[CLS]", 102: "[SEP]", 103: "[MASK]", 1012: ".", 1029: "?"}
    letters = "abcdefghijklmnopqrstuvwxyz0123456789"
    pieces = [*letters, *("##" + letter for letter in letters), *WORDS, *"!\"#$%&'()*+,-/:;<=>@[\\]^_`{|}~"]
    pieces += ["##ing", "##s", "##ed", "##er", "##house", "##top", "##scraper", "sky", "haus", "strasse", "eglise", "中", "国", "楼", "δ", "ж", "##ж", "и", "##и"]
    pieces = [piece for piece in dict.fromkeys(pieces) if piece not in fixed.values()]
    free = iter(pieces)
    return {fixed[i] if i in fixed else next(free, f"[unused{i}]"): i for i in range(1100)}


def make_tokenizer(path):
    tokenizer = tokenizers.Tokenizer(tokenizers.models.WordPiece(vocabulary(), unk_token="[UNK]", max_input_chars_per_word=100))
    tokenizer.normalizer = tokenizers.normalizers.BertNormalizer(lowercase=True)
    tokenizer.pre_tokenizer = tokenizers.pre_tokenizers.BertPreTokenizer()
    tokenizer.post_processor = tokenizers.processors.BertProcessing(("[SEP]", 102), ("[CLS]", 101))
    tokenizer.decoder = tokenizers.decoders.WordPiece()
    tokenizer.add_special_tokens(["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]"])
    tokenizer.save(str(path), pretty=False)
    return tokenizer


def sentences():
    rng = random.Random(SEED)
    given = ["", " ", ".", "buildings.", "Buildings .", "BUILDINGS. Trees.", "a red roof . small houses . trees .", "skyscrapers!", "rooftop",
             "Straße", "Église Notre-Dame", "café naïve", "İstanbul", "ﬁne ﬂat roofs", "中国楼 building", "жилой дом", "Δ-roof", "x" * 100, "x" * 101,
             "[SEP] a [MASK] b [CLS]", "[sep]", "a\tb\nc\r\nd", "a\u00a0b\u2003c", "zero\u200bwidth\u200djoin", "soft\u00adhyphen", "\ufeffbom", "null\0char\ufffd",
             "e\u0301cole", "n\u0303", "q\u0323\u0307", "❤️ roof 🏠", "1,234.56 m²", "½ of a ¾ roof", "«quoted» “roof” — a–b", "don't can't it's", "a.b.c...", "東京タワー",
             "ค้า", "हिन्दी", "אֶרֶץ", "\u0130\u0131", "ǅ ǆ", "ß ẞ", "Ω ohm Å", "㎡ ㍿", "a_b-c/d\\e", "$100 #1 @home 50%", "{[(<>)]}", "\u2028line\u2029para", "\x7f\x80", "𝒳 𝔸", "ⅷ Ⅷ"]
    marks = list(".,;:!?-_/'\"()[]{}…·¿¡。、") + [" ", "  ", "\t", "\n", "\u00a0", "\u3000"]
    odd = list("éÜñçßøåŁœÆžğİıΣσςЖжשא中国楼の한ﬁ½²①")
    while len(given) < 360:
        parts = []
        for _ in range(rng.randint(1, 9)):
            word = rng.choice(WORDS)
            change = rng.random()
            if change < 0.2:
                word = word.upper()
            elif change < 0.4:
                at = rng.randint(0, len(word))
                word = word[:at] + rng.choice(odd) + word[at:]
            elif change < 0.5:
                word = word + rng.choice(["s", "ing", "house", "top", "scraper", "ed"])
            elif change < 0.6:
                word = "".join(rng.choice("abcxyz0189ж") for _ in range(rng.randint(1, 12)))
            parts += [word, rng.choice(marks) if rng.random() < 0.5 else " "]
        given.append("".join(parts))
    return given


def make_words(tokenizer):
    cases = [[text, tokenizer.encode(text).ids] for text in sentences()]
    rng = random.Random(SEED + 1)
    decoded = []
    for _ in range(60):
        ids = [rng.choice([*range(101, 104), *range(1, 99), *range(104, 200), 1012, 1029]) for _ in range(rng.randint(0, 8))]
        decoded.append([ids, tokenizer.decode(ids, skip_special_tokens=False)])
    special = torch.tensor([101, 102, 1012, 1029])
    blocks = []
    for text in ("buildings.", "a red roof . small houses . trees .", "a . b ? c", ". .", "no end"):
        ids = tokenizer.encode(text).ids
        attention, position = dino.generate_masks_with_special_tokens_and_transfer_map(torch.tensor([ids]), special)
        blocks.append({"ids": ids, "attention": attention[0].int().tolist(), "position": position[0].tolist()})
    write("words.json", {"encode": cases, "decode": decoded, "blocks": blocks})


# ---------------------------------------------------------------------------------------------------------------------
# The two networks.


def shaken(model, amount):
    """Initialisation zeroes many terms; a network of zeros proves nothing."""
    generator = torch.Generator().manual_seed(SEED)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(torch.randn(parameter.shape, generator=generator) * amount)
    return model.eval()


def tiny_dino():
    torch.manual_seed(SEED)
    config = transformers.GroundingDinoConfig(
        backbone_config=transformers.SwinConfig(
            embed_dim=8, depths=[1, 1, 2, 1], num_heads=[1, 2, 4, 8], window_size=2, image_size=96, out_features=["stage2", "stage3", "stage4"]),
        text_config=dict(model_type="bert", vocab_size=1100, hidden_size=16, num_hidden_layers=2, num_attention_heads=2, intermediate_size=32, max_position_embeddings=64),
        d_model=32, encoder_layers=2, decoder_layers=2, encoder_ffn_dim=32, decoder_ffn_dim=32, encoder_attention_heads=4, decoder_attention_heads=4,
        num_queries=50, max_text_len=32, disable_custom_kernels=True)
    model = shaken(transformers.GroundingDinoForObjectDetection(config), 0.1)
    with torch.no_grad():
        # Scores spread between 0 and 1 instead of all being 1.
        model.model.decoder.layer_norm.weight *= 0.12
        model.model.decoder.layer_norm.bias *= 0.12
    return model


def tiny_sam2():
    torch.manual_seed(SEED)
    quarter = SQUARE // 4
    config = sam2.Sam2Config(
        vision_config=sam2.Sam2VisionConfig(
            backbone_config=sam2.Sam2HieraDetConfig(
                hidden_size=8, image_size=[SQUARE, SQUARE], blocks_per_stage=[1, 2, 3, 2], embed_dim_per_stage=[8, 16, 32, 64], num_attention_heads_per_stage=[1, 1, 2, 4],
                window_size_per_stage=[8, 4, 8, 4], global_attention_blocks=[4, 5], window_positional_embedding_background_size=[7, 7]),
            backbone_channel_list=[64, 32, 16, 8], backbone_feature_sizes=[[quarter, quarter], [quarter // 2, quarter // 2], [quarter // 4, quarter // 4]], fpn_hidden_size=32),
        prompt_encoder_config=sam2.Sam2PromptEncoderConfig(hidden_size=32, image_size=SQUARE),
        mask_decoder_config=sam2.Sam2MaskDecoderConfig(hidden_size=32, mlp_dim=64, num_attention_heads=4, iou_head_hidden_dim=32))
    model = shaken(transformers.Sam2Model(config), 0.12)
    with torch.no_grad():
        # Predicted overlaps spread, and masks have an inside and an outside.
        model.mask_decoder.iou_prediction_head.proj_out.weight *= 6
        heads = model.mask_decoder.output_hypernetworks_mlps
        heads[0], heads[2] = heads[2], heads[0]  # the first marks half of a picture, not a hundredth
        for head in heads:
            head.proj_out.weight *= 30
            head.proj_out.bias *= 30
    return model


def shortened(path):
    """Names of inner values as numbers: half of a tiny graph is names."""
    model = onnx.load(path)
    kept = {value.name for value in [*model.graph.input, *model.graph.output]}
    names = {"": ""}

    def short(name):
        return name if name in kept else names.setdefault(name, f"{len(names):x}")

    def visit(graph):
        del graph.value_info[:]
        for tensor in graph.initializer:
            tensor.name = short(tensor.name)
            tensor.doc_string = ""
        for value in graph.output:
            value.name = short(value.name)
        for index, node in enumerate(graph.node):
            node.name, node.doc_string = f"{node.op_type}{index}", ""
            node.input[:] = [short(name) for name in node.input]
            node.output[:] = [short(name) for name in node.output]
            for attribute in node.attribute:
                if attribute.type == onnx.AttributeProto.GRAPH:
                    visit(attribute.g)

    visit(model.graph)
    onnx.save(model, path)


def make_bundles():
    source = HERE / "source"
    source.mkdir(exist_ok=True)
    tokenizer = make_tokenizer(source / "tokenizer.json")
    detector, segmenter = tiny_dino(), tiny_sam2()
    real_onnx_export = torch.onnx.export

    def short_export(model, inputs, path, **named):
        real_onnx_export(model, inputs, path, **named)
        shortened(path)

    torch.onnx.export = short_export
    bundles = HERE / "bundles"
    export.detector_bundle(source, bundles / "tiny-dino", sizes=((131, 99), (96, 160)), shortest=SHORTEST, longest=LONGEST, model=detector)
    # The same without the fourth patch: declares open sizes and is wrong at all but one.
    frozen = bundles / "frozen-dino"
    frozen.mkdir(exist_ok=True)
    export.export_detector(detector, frozen / "detector.onnx", (131, 99), [101, 7, 1012, 102], with_sizes=False)
    export.segmenter_bundle("tiny-sam2", bundles / "tiny-sam2", model=segmenter)
    torch.onnx.export = real_onnx_export
    (source / "tokenizer.json").unlink()
    source.rmdir()
    return tokenizer, detector, segmenter


def make_cubic():
    """A graph with a cubic resize, as SAM 2's encoder has where nobody folds it."""
    helper, floats = onnx.helper, onnx.TensorProto.FLOAT
    node = helper.make_node("Resize", ["pixel_values", "", "scales"], ["image_embeddings.0"], name="/pos_embed/Resize", mode="cubic")
    scales = helper.make_tensor("scales", floats, [4], [1.0, 1.0, 2.0, 2.0])
    info = [helper.make_tensor_value_info(name, floats, [1, 3, size, size]) for name, size in [("pixel_values", 8), ("image_embeddings.0", 16)]]
    graph = helper.make_graph([node], "cubic", info[:1], info[1:], [scales])
    folder = HERE / "bundles" / "cubic-sam2"
    folder.mkdir(exist_ok=True)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", export.OPSET)]), folder / "encoder.onnx")


# ---------------------------------------------------------------------------------------------------------------------
# What Python says.


def write(name, value):
    (HERE / name).write_text(json.dumps(value, ensure_ascii=False))
    print(f"wrote {name}: {(HERE / name).stat().st_size} bytes")


def picture(seed, width, height):
    """[height, width, 3] uint8"""
    return np.ascontiguousarray(export.test_picture(seed, width, height).transpose(1, 2, 0))


def make_pixels():
    """Pillow's and torch's resizing, sampled."""
    cases = []
    for seed, (w, h), (tw, th) in [(1, (300, 200), (144, 96)), (2, (97, 131), (96, 130)), (3, (64, 48), (128, 96)), (4, (1000, 30), (128, 128)), (5, (200, 200), (128, 128))]:
        source = picture(seed, w, h)
        pillow = np.asarray(Image.fromarray(source).resize((tw, th), Image.Resampling.BILINEAR))
        floats = torch.from_numpy(source).permute(2, 0, 1)[None].float() / 255
        smooth = functional.interpolate(floats, (th, tw), mode="bilinear", antialias=True)[0].permute(1, 2, 0).numpy()
        cases.append({"seed": seed, "from": [w, h], "to": [tw, th], "step": 41,
                      "pillow": pillow.reshape(-1)[::41].tolist(), "torch": export.rounded(smooth.reshape(-1)[::41])})
    sizes = []
    for w, h in [(4000, 3000), (3000, 4000), (800, 800), (5472, 3648), (1333, 800), (1334, 800), (2000, 100), (100, 2000), (640, 480), (799, 1601), (6000, 1999), (33, 31), (801, 1333), (1000, 599)]:
        th, tw = get_size((h, w), 800, 1333)
        sizes.append([w, h, tw, th])
    logits = grid_logits(16, 16)
    ups = []
    for w, h in [(40, 30), (16, 16), (7, 50), (129, 65)]:
        up = functional.interpolate(torch.from_numpy(logits)[None, None], (h, w), mode="bilinear", align_corners=False)[0, 0].numpy()
        ups.append({"to": [w, h], "values": export.rounded(up.reshape(-1)[::7]), "above": int((up > 0).sum()),
                    "stability": float(((up > 1).sum()) / max(1, (up > -1).sum()))})
    write("pixels.json", {"resize": cases, "sizes": sizes, "logits": export.rounded(logits.reshape(-1)), "upsample": ups})


def grid_logits(width, height):
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    return (4 * np.sin(x / 2.3) * np.cos(y / 3.1) + 0.3 * x - 0.25 * y).astype(np.float32)


def get_size(image_size, size, longest):
    from transformers.image_transforms import get_size_with_aspect_ratio
    return get_size_with_aspect_ratio(image_size, size, longest)


def blob(seed, width, height):
    p = export.test_picture(seed, width, height)[0]
    return (p > 128).astype(np.uint8)


def make_shapes():
    """Run lengths, suppression, grids and crops."""
    rle = []
    for seed, (w, h) in [(1, (5, 4)), (2, (40, 33)), (3, (1, 9)), (4, (64, 64))]:
        mask = blob(seed, w, h)
        for m in (mask, np.zeros_like(mask), np.ones_like(mask)):
            code = coco.encode(np.asfortranarray(m))
            rle.append({"width": w, "height": h, "mask": m.reshape(-1).tolist(), "counts": code["counts"].decode(), "area": int(coco.area(code))})
    rng = np.random.default_rng(SEED)
    corner = rng.uniform(0, 80, (60, 2))
    boxes = np.concatenate([corner, corner + rng.uniform(2, 40, (60, 2))], 1).astype(np.float32)
    scores = rng.permutation(60).astype(np.float32) / 60
    crops = [{"size": [w, h], "layers": n, "boxes": crop_boxes(w, h, n)} for w, h, n in [(640, 480, 0), (640, 480, 1), (1500, 700, 2), (99, 101, 1)]]
    write("shapes.json", {"rle": rle, "boxes": boxes.tolist(), "scores": scores.tolist(), "kept": {str(t): suppress(boxes, scores, t) for t in (0.3, 0.5, 0.7)},
                          "grid4": grid(4).tolist(), "grid3": grid(3).tolist(), "crops": crops})


def suppress(boxes, scores, threshold):
    kept = []
    for i in np.argsort(-scores, kind="stable"):
        if all(box_iou(boxes[i], boxes[k]) <= threshold for k in kept):
            kept.append(int(i))
    return kept


def box_iou(a, b):
    inner = max(0.0, min(a[2], b[2]) - max(a[0], b[0])) * max(0.0, min(a[3], b[3]) - max(a[1], b[1]))
    both = (a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - inner
    return inner / both if both > 0 else 0.0


def grid(count):
    side = np.linspace(0.5 / count, 1 - 0.5 / count, count)
    return np.stack([np.tile(side, (count, 1)), np.tile(side[:, None], (1, count))], -1).reshape(-1, 2)


def crop_boxes(width, height, layers, overlap_ratio=512 / 1500):
    boxes = [[0, 0, width, height]]
    for layer in range(layers):
        count = 2 ** (layer + 1)
        overlap = int(overlap_ratio * min(width, height) * (2 / count))
        w = int(np.ceil((overlap * (count - 1) + width) / count))
        h = int(np.ceil((overlap * (count - 1) + height) / count))
        for x0 in [int((w - overlap) * i) for i in range(count)]:
            for y0 in [int((h - overlap) * i) for i in range(count)]:
                boxes.append([x0, y0, min(x0 + w, width), min(y0 + h, height)])
    return boxes


# ---------------------------------------------------------------------------------------------------------------------
# The reference pipeline: lang-segment-anything's steps on the PyTorch networks.


def detect(model, tokenizer, source, prompt, box_threshold, text_threshold):
    height, width = source.shape[:2]
    th, tw = get_size((height, width), SHORTEST, LONGEST)
    resized = np.asarray(Image.fromarray(source).resize((tw, th), Image.Resampling.BILINEAR)).transpose(2, 0, 1)
    prompt = prompt if prompt.endswith(".") else prompt + "."
    ids = torch.tensor([tokenizer.encode(prompt).ids])
    with torch.no_grad():
        found = model(pixel_values=export.normalised(resized), input_ids=ids, token_type_ids=torch.zeros_like(ids), attention_mask=torch.ones_like(ids),
                      pixel_mask=torch.ones((1, th, tw), dtype=torch.long))
    share = torch.sigmoid(found.logits[0])
    scores = share.max(-1).values
    rows = (scores > box_threshold).nonzero()[:, 0].tolist()
    boxes, labels = [], []
    for row in rows:
        cx, cy, w, h = found.pred_boxes[0, row].tolist()
        boxes.append([(cx - w / 2) * width, (cy - h / 2) * height, (cx + w / 2) * width, (cy + h / 2) * height])
        chosen = [i for i in (share[row] > text_threshold).nonzero()[:, 0].tolist() if 0 < i < 255 and i < ids.shape[1]]
        labels.append(tokenizer.decode([int(ids[0, i]) for i in chosen], skip_special_tokens=False))
    return boxes, [float(scores[row]) for row in rows], labels, sorted(scores.tolist(), reverse=True)


def embed(encoder, source):
    floats = torch.from_numpy(source).permute(2, 0, 1)[None].float() / 255
    squashed = functional.interpolate(floats, (SQUARE, SQUARE), mode="bilinear", antialias=True)
    mean, std = (torch.tensor(v)[None, :, None, None] for v in (export.MEAN, export.STD))
    with torch.no_grad():
        return encoder((squashed - mean) / std)


def decode(decoder, levels, points, labels):
    """points [prompts][n][2] in the square's pixels -> logits [prompts, 4, s, s], scores [prompts, 4]"""
    with torch.no_grad():
        masks, scores, _ = decoder(torch.tensor([points], dtype=torch.float32), torch.tensor([labels]), *levels)
    return masks[0], scores[0]


def full_size(logits, height, width):
    return functional.interpolate(logits[None], (height, width), mode="bilinear", align_corners=False)[0]


def rle_of(mask):
    return coco.encode(np.asfortranarray(mask.astype(np.uint8)))["counts"].decode()


def make_runs(tokenizer, detector, segmenter):
    encoder, decoder = export.Encoder(segmenter).eval(), export.Decoder(segmenter).eval()
    runs = []
    for seed, (w, h), prompt in [(11, (220, 150), "buildings"), (12, (150, 190), "a red roof . trees ."), (13, (400, 120), "Houses.")]:
        source = picture(seed, w, h)
        ranked = detect(detector, tokenizer, source, prompt, 0.0, 0.25)[3]
        # Between two scores that lie apart, so that no rounding decides.
        cut = max(range(3, 9), key=lambda i: ranked[i] - ranked[i + 1])
        threshold = (ranked[cut] + ranked[cut + 1]) / 2
        boxes, scores, labels, _ = detect(detector, tokenizer, source, prompt, threshold, 0.25)
        levels = embed(encoder, source)
        scale = np.array([SQUARE / w, SQUARE / h] * 2)
        corners = [(np.array(box) * scale).reshape(2, 2).tolist() for box in boxes]
        logits, iou = decode(decoder, levels, corners, [[2, 3]] * len(boxes))
        single = full_size(logits[:, 0], h, w) > 0
        best = torch.stack([full_size(logits[i, 1 + iou[i, 1:].argmax()][None], h, w)[0] > 0 for i in range(len(boxes))])
        runs.append({"seed": seed, "size": [w, h], "prompt": prompt, "box_threshold": threshold, "boxes": boxes, "scores": scores, "labels": labels,
                     "single": [rle_of(m.numpy()) for m in single], "union": rle_of(single.any(0).numpy()), "best_union": rle_of(best.any(0).numpy()),
                     "coverage": float(single.any(0).float().mean())})
    clicks = []
    for seed, (w, h), points, labels in [(21, (200, 140), [[50, 60]], [1]), (22, (140, 200), [[20, 30], [100, 150], [70, 20]], [1, 1, 0]), (23, (180, 180), [[30, 40], [150, 160], [90, 90]], [2, 3, 1])]:
        levels = embed(encoder, picture(seed, w, h))
        inside = (np.array(points) * [SQUARE / w, SQUARE / h]).tolist()
        logits, iou = decode(decoder, levels, [inside], [labels])
        clicks.append({"seed": seed, "size": [w, h], "points": points, "labels": labels, "scores": export.rounded(iou[0].numpy()),
                       "masks": [rle_of((full_size(logits[0, k][None], h, w)[0] > 0).numpy()) for k in range(4)]})
    write("runs.json", {"language": runs, "clicks": clicks, "everything": [everything(encoder, decoder, 31, 160, 120, 0), everything(encoder, decoder, 32, 150, 150, 1)]})


def everything(encoder, decoder, seed, width, height, layers, side=6, overlap=0.95):
    """SAM 2's automatic mask generator; thresholds chosen where random scores lie apart."""
    source = picture(seed, width, height)
    crops = crop_boxes(width, height, layers)
    found = []
    for crop in crops:
        x0, y0, x1, y1 = crop
        w, h = x1 - x0, y1 - y0
        levels = embed(encoder, np.ascontiguousarray(source[y0:y1, x0:x1]))
        for place in grid(side):
            logits, scores = decode(decoder, levels, [[(place * SQUARE).tolist()]], [[1]])
            for k in (1, 2, 3):
                up = full_size(logits[0, k][None], h, w)[0].numpy()
                steady = (up > 1).sum() / max(1, (up > -1).sum())
                found.append((crop, float(scores[0, k]), float(steady), up > 0))
    gap = lambda values, share: max(range(int(len(values) * share), int(len(values) * share) + 20), key=lambda i: values[i + 1] - values[i])
    ranked = sorted(f[1] for f in found)
    at = gap(ranked, 0.5)
    least_iou = (ranked[at] + ranked[at + 1]) / 2
    kept = [f for f in found if f[1] > least_iou]
    ranked = sorted(f[2] for f in kept)
    at = gap(ranked, 0.3)
    least_steady = (ranked[at] + ranked[at + 1]) / 2
    masks = []
    for crop in crops:
        rows = []
        for _, score, steady, mask in (f for f in kept if f[0] == crop and f[2] >= least_steady):
            ys, xs = np.nonzero(mask)
            box = np.array([xs.min(), ys.min(), xs.max(), ys.max()], float) if len(xs) else np.zeros(4)
            box += np.array([crop[0], crop[1], crop[0], crop[1]])
            near = (np.abs(box - np.array(crop)) <= 20) & ~(np.abs(box - np.array([0, 0, width, height])) <= 20)
            if near.any():
                continue
            whole = np.zeros((height, width), bool)
            whole[crop[1]:crop[3], crop[0]:crop[2]] = mask
            rows.append((box, score, whole, crop))
        if rows:
            masks += [rows[i] for i in suppress(np.array([r[0] for r in rows]), np.array([r[1] for r in rows]), overlap)]
    if len(crops) > 1:
        scores = np.array([1 / ((r[3][2] - r[3][0]) * (r[3][3] - r[3][1])) for r in masks])
        masks = [masks[i] for i in suppress(np.array([r[0] for r in masks]), scores, overlap)]
    return {"seed": seed, "size": [width, height], "layers": layers, "side": side, "least_iou": least_iou, "least_stability": least_steady, "overlap": overlap,
            "masks": [{"counts": rle_of(m[2]), "iou": m[1]} for m in masks]}


def make_parity(tokenizer, detector, segmenter):
    """The networks alone, every way that they are fed; nothing is resized."""
    short, long = (tokenizer.encode(text).ids for text in ("buildings.", "a red roof . small houses . trees ."))
    padded_text = short + [0] * (len(long) - len(short))
    cases = []
    for name, seeds, (w, h), (wide, high), texts in [
        ("short text", [43], (128, 96), (128, 96), [short]), ("long text", [44], (128, 96), (128, 96), [long]),
        ("short text, odd size", [45], (113, 157), (113, 157), [short]), ("long text, odd size", [46], (113, 157), (113, 157), [long]),
        ("padded picture", [41], (128, 96), (160, 128), [short]), ("odd picture, padded", [47], (113, 91), (160, 157), [long]),
        ("batch of two, padded text", [41, 42], (128, 96), (128, 96), [long, padded_text]),
    ]:
        pixels, cover = torch.zeros(len(seeds), 3, high, wide), torch.zeros((len(seeds), high, wide), dtype=torch.long)
        for row, seed in enumerate(seeds):
            pixels[row, :, :h, :w] = export.normalised(export.test_picture(seed, w, h))[0]
        cover[:, :h, :w] = 1
        ids = torch.tensor(texts)
        with torch.no_grad():
            found = detector(pixel_values=pixels, input_ids=ids, token_type_ids=torch.zeros_like(ids), attention_mask=(ids > 0).long(), pixel_mask=cover)
        cases.append({"name": name, "seeds": seeds, "picture": [w, h], "canvas": [wide, high], "ids": texts,
                      "boxes": export.rounded(found.pred_boxes.numpy()), "scores": export.rounded(found.logits.max(-1).values.numpy())})
    write("parity.json", {"detector": cases, "segmenter": segmenter_parity(segmenter)})


def segmenter_parity(segmenter):
    """Embeddings and the masks of all four tokens, sampled; one decoder call per case."""
    encoder, decoder = export.Encoder(segmenter).eval(), export.Decoder(segmenter).eval()
    cases = []
    for name, seed, points, labels in [
        ("one box", 51, [[[20, 30], [90, 110]]], [[2, 3]]), ("three boxes", 52, [[[5, 9], [60, 70]], [[40, 2], [127, 50]], [[0, 0], [128, 128]]], [[2, 3]] * 3),
        ("one point", 53, [[[64, 40]]], [[1]]), ("two points and one that is not it", 54, [[[30, 30], [50, 90], [100, 20]]], [[1, 1, 0]]),
        ("a box and a point", 55, [[[10, 20], [100, 120], [50, 60]]], [[2, 3, 1]]), ("sixteen points", 56, [[[8 * i + 3, 100 - 5 * i]] for i in range(16)], [[1]] * 16),
    ]:
        with torch.no_grad():
            levels = encoder(export.normalised(export.test_picture(seed, SQUARE, SQUARE)))
        logits, scores = decode(decoder, levels, points, labels)
        sampled = lambda values, step: {"step": step, "values": export.rounded(values.reshape(-1)[::step].numpy()), "largest": float(values.abs().max())}
        cases.append({"name": name, "seed": seed, "points": points, "labels": labels, "levels": [sampled(level, level.numel() // 100) for level in levels],
                      "masks": sampled(logits, 37 * len(points)), "scores": export.rounded(scores.reshape(-1).numpy())})
    return cases


def main():
    transformers.logging.set_verbosity_error()
    tokenizer, detector, segmenter = make_bundles()
    make_cubic()
    make_words(tokenizer)
    make_pixels()
    make_shapes()
    make_parity(tokenizer, detector, segmenter)
    make_runs(tokenizer, detector, segmenter)


if __name__ == "__main__":
    main()
