//! Reads `.gdibl` files and reconstructs light from them.
