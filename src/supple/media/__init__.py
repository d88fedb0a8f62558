"""Files in and files out: a module for each medium, as `supple.media.base` says what media give and take."""
