"""The engine in shaders (WGSL), for images, stacks of frames and volumes."""
