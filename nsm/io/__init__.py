"""Files: checkpoints, the published networks, meshes, and loading a morph by name."""
