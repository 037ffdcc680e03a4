"""OpenCV, which is optional."""


def require_cv2():
    """The module. Raises ImportError, which says how to install it."""
    try:
        import cv2
    except ImportError as missing:
        problem = 'automatic masks and stereo need OpenCV, which is optional: pip install -e ".[reconstruct]"'
        raise ImportError(problem) from missing
    return cv2
