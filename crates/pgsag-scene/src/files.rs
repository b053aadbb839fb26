//! Codecs: bytes <-> words. Nothing outside this folder touches bytes of a foreign format.
