//! What the WebAssembly module has beside the C interface: memory for the page's arrays, an allocator, and what a panic
//! does. `integrations/web/gdibl.mjs` is the other side.

use alloc::alloc::{alloc, dealloc};
use core::alloc::Layout;
use core::ptr;
use lol_alloc::{AssumeSingleThreaded, FreeListAllocator};

#[global_allocator]
// SAFETY: without the target feature `atomics` a module has one thread.
static ALLOCATOR: AssumeSingleThreaded<FreeListAllocator> =
    unsafe { AssumeSingleThreaded::new(FreeListAllocator::new()) };

/// A trap: an exception in JavaScript.
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    core::arch::wasm32::unreachable()
}

/// Enough for every number of the C interface.
const ALIGNMENT: usize = 8;

/// `size` bytes of the module's memory, at a multiple of 8; 0 if there are none. The memory may have grown: views of it
/// that were made before are then detached.
#[unsafe(no_mangle)]
pub extern "C" fn gdibl_allocate(size: usize) -> *mut u8 {
    match Layout::from_size_align(size.max(1), ALIGNMENT) {
        // SAFETY: the size is not 0.
        Ok(layout) => unsafe { alloc(layout) },
        Err(_) => ptr::null_mut(),
    }
}

/// Gives memory back.
///
/// # Safety
/// `memory` is 0, or came from `gdibl_allocate` with the same `size` and was not given back.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn gdibl_deallocate(memory: *mut u8, size: usize) {
    if let (false, Ok(layout)) = (memory.is_null(), Layout::from_size_align(size.max(1), ALIGNMENT)) {
        // SAFETY: `gdibl_allocate` gave it for this layout.
        unsafe { dealloc(memory, layout) };
    }
}
