"""Files of pictures, clips, volumes, transforms and points, read and written."""
