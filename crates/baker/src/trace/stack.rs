//! A stack of keys whose places start unwritten. With `simd` one of the two files with `unsafe`.

#![allow(unsafe_code, reason = "memory that is not cleared for every ray; a proof stands at each block")]

use std::mem::MaybeUninit;

/// Up to `SIZE` keys. Clearing the places before every ray took up to a quarter of the time of short rays.
pub struct Stack<const SIZE: usize> {
    /// Those below `top` are written.
    places: [MaybeUninit<u64>; SIZE],
    top: usize,
}

impl<const SIZE: usize> Stack<SIZE> {
    #[inline(always)]
    pub fn new() -> Self {
        Stack { places: [MaybeUninit::uninit(); SIZE], top: 0 }
    }

    #[inline(always)]
    pub fn len(&self) -> usize {
        self.top
    }

    #[inline(always)]
    pub fn push(&mut self, key: u64) {
        self.places[self.top].write(key);
        self.top += 1;
    }

    #[inline(always)]
    pub fn pop(&mut self) -> Option<u64> {
        if self.top == 0 {
            return None;
        }
        self.top -= 1;
        // It was below `top`.
        Some(unsafe { self.places[self.top].assume_init() })
    }

    /// Puts a key among those from place `base` on, which fall towards the top.
    #[inline(always)]
    pub fn insert(&mut self, base: usize, key: u64) {
        let mut at = self.top;
        // `at - 1` is below `top`, and `base` not negative.
        while at > base && unsafe { self.places[at - 1].assume_init() } < key {
            self.places[at] = self.places[at - 1];
            at -= 1;
        }
        self.places[at].write(key);
        self.top += 1;
    }
}
