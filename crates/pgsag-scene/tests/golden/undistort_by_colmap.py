"""COLMAP's undistortion as PNG files: of the images of a COLMAP workspace, or of the small golden image.

    pip install pycolmap==4.2.1 numpy pillow
    python undistort_by_colmap.py WORKSPACE OUT      # every image of WORKSPACE/sparse/0
    python undistort_by_colmap.py --golden           # photo.png -> photo_undistorted.png, here
"""
import pathlib
import sys

import numpy as np
import pycolmap
from PIL import Image

OPTIONS = pycolmap.UndistortCameraOptions()


def undistort(image_path, camera, out_path):
    bitmap = pycolmap.Bitmap.read(str(image_path), True)
    undistorted, target = pycolmap.undistort_image(OPTIONS, bitmap, camera)
    out_path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(undistorted.to_array()).save(out_path)
    print(out_path, target)


def golden():
    here = pathlib.Path(__file__).parent
    y, x = np.mgrid[0:72, 0:96].astype(float)
    waves = [np.sin(x * 0.31) * np.cos(y * 0.23), np.sin(x * 0.11 + y * 0.17), np.cos(np.hypot(x - 40, y - 30) * 0.5)]
    rgb = np.stack([np.round(127.5 + 120 * wave) for wave in waves], -1).astype(np.uint8)
    Image.fromarray(rgb).save(here / "photo.png")
    params = [100.0, 102.0, 47.0, 37.0, -0.25, 0.1, 2e-3, -4e-3]
    camera = pycolmap.Camera(model="OPENCV", width=96, height=72, params=params)
    undistort(here / "photo.png", camera, here / "photo_undistorted.png")


if sys.argv[1] == "--golden":
    golden()
else:
    workspace, out = map(pathlib.Path, sys.argv[1:])
    model = pycolmap.Reconstruction(str(workspace / "sparse" / "0"))
    for image in model.images.values():
        camera = model.cameras[image.camera_id]
        undistort(workspace / "images" / image.name, camera, out / (image.name + ".png"))
