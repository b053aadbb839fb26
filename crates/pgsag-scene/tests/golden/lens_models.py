"""Writes lens_models.json (see tests/golden/README.md). Run with pycolmap 4.2.1 and numpy."""
import json, sys
import numpy as np, pycolmap
rng = np.random.default_rng(7)
P = {
 "SIMPLE_PINHOLE": [900, 700, 500],
 "PINHOLE": [900, 910, 690, 510],
 "SIMPLE_RADIAL": [900, 700, 500, -0.12],
 "RADIAL": [900, 700, 500, -0.2, 0.08],
 "OPENCV": [900, 910, 690, 510, -0.25, 0.12, 1e-3, -2e-3],
 "OPENCV_FISHEYE": [700, 705, 690, 510, -0.03, 0.01, -4e-3, 5e-4],
 "FULL_OPENCV": [900, 910, 690, 510, 0.3, -0.1, 1e-3, -2e-3, 0.02, 0.35, 0.02, 0.005],
 "FOV": [900, 910, 690, 510, 0.9],
 "SIMPLE_RADIAL_FISHEYE": [700, 690, 510, 0.02],
 "RADIAL_FISHEYE": [700, 690, 510, -0.02, 3e-3],
 "THIN_PRISM_FISHEYE": [700, 705, 690, 510, -0.03, 0.01, 1e-3, -1e-3, -2e-3, 2e-4, 5e-4, -5e-4],
}
out = []
for name, params in P.items():
    cam = pycolmap.Camera(model=name, width=1400, height=1000, params=[float(p) for p in params])
    und = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), cam)
    rows = []
    for _ in range(12):
        pt = np.array([rng.uniform(-.7, .7), rng.uniform(-.5, .5), 1.0]) * rng.uniform(.5, 20)
        rows.append([*pt.tolist(), *cam.img_from_cam(pt).tolist()])
    inv = []
    for _ in range(12):
        xy = np.array([rng.uniform(0, 1400), rng.uniform(0, 1000)])
        inv.append([*xy.tolist(), *cam.cam_from_img(xy).tolist()])
    out.append({"model": name, "number": int(cam.model), "width": 1400, "height": 1000, "params": list(map(float, params)),
                "undistorted": [und.width, und.height, *und.params.tolist()], "project": rows, "unproject": inv})
json.dump({"made_by": "pycolmap " + pycolmap.__version__, "cameras": out}, open(sys.argv[1], "w"), indent=1)
