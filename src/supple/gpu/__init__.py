"""The engine in shaders (WGSL), for images, stacks of frames and volumes: the same rooms and names as `supple.cpu`."""
