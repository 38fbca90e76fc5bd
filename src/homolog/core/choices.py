"""The words and bounds that options may have, kept apart from what acts on them: reading them loads no PyTorch."""

from typing import Literal

Side = Literal["source", "target"]
"""One of the two shapes of a match."""
Parts = Literal["source", "target", "both"]
"""Which of the two shapes of a match are partial."""
Mirror = Literal["source", "target", "auto"]
"""Which of the two shapes of a match is reflected first: one of them, or the source where they are mirror images."""
AsCloud = Literal["source", "target", "both"]
"""Whose faces are dropped."""
Device = Literal["auto", "cpu", "cuda"]
"""Where to compute; ``"auto"`` takes a GPU where there is one."""
Up = Literal["x", "y", "z"]
"""The axis that points up in a file."""
Orient = Literal["auto", "given"]
"""Whether the way round of shapes is found, or trusted as their files have it."""
KeepClutter = Literal["remove", "keep"]
"""Whether outliers, backgrounds and other objects are set apart before a shape is matched, or kept."""
UseProxy = Literal["auto", "never", "always"]
"""Whether a surface around a shape is matched in its place: where it needs one, never, or always."""
OutlierKind = Literal["box", "clusters", "near"]
"""Where outliers lie: anywhere in the bounding box, in clusters there, or near the surface."""
Background = Literal["none", "floor"]
"""What stands around a shape."""
Modalities = Literal["mesh", "cloud", "mesh-to-cloud", "cloud-to-mesh"]
"""What the source and the target of an evaluation are used as."""
Turn = Literal["none", "vertical", "any"]
"""Which rotations are drawn: none, about the vertical axis, or any, all of them as likely."""
Poses = Literal["natural", "wide"]
"""Which poses synthetic people have."""
Bone = Literal["femur", "tibia", "fibula", "patella", "hip", "sacrum"]
"""Which bone is made."""
HandSides = Literal["both", "left", "right"]
"""Which hands are made."""
Split = Literal["train", "test", "all"]
"""Which shapes of a dataset."""
System = Literal["LPS", "RAS"]
"""Which way a scan's axes point: to the patient's left, back and head, or to the right, front and head."""

TEXTURE_SIZE = 1024
"""Width and height of a transferred texture in texels, where none is given."""
PICTURE_WIDTHS = (100, 6000)
"""The narrowest and the widest picture of a match, in pixels."""
