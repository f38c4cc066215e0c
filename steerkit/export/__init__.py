"""Out of steerkit: C, FMU, ONNX, Minari."""
