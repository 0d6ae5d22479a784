"""MJCF files of models: source, keyframe, starts by joint names, drawing."""
