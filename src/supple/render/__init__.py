"""Pictures of volumes: a scene, a camera, transfer functions, and the files that they are written to."""
