//! What the hierarchy is made of: nodes of eight boxes, and blocks of triangles.

use super::triangle::TriangleBlock;

/// Children per node.
pub const WIDTH: usize = 8;

/// A node, or the blocks of a leaf, in 32 bits: the index of the node; or the highest bit, three bits of how many
/// blocks less one, and the index of the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Child(pub u32);

impl Child {
    const LEAF: u32 = 1 << 31;
    const INDEX_BITS: u32 = 28;
    /// Most blocks of a leaf.
    pub const MAX_BLOCKS: usize = 8;

    /// An inner node.
    pub fn node(index: usize) -> Child {
        assert!(index < Child::LEAF as usize, "{index} nodes");
        Child(index as u32)
    }

    /// A leaf of 1..=8 blocks.
    pub fn leaf(first: usize, count: usize) -> Child {
        assert!(
            (1..=Child::MAX_BLOCKS).contains(&count) && first < 1 << Child::INDEX_BITS,
            "{count} blocks at {first}"
        );
        Child(Child::LEAF | ((count - 1) as u32) << Child::INDEX_BITS | first as u32)
    }

    /// The blocks of a leaf.
    #[inline(always)]
    pub fn blocks(self) -> Option<std::ops::Range<usize>> {
        let first = (self.0 & ((1 << Child::INDEX_BITS) - 1)) as usize;
        let count = (self.0 >> Child::INDEX_BITS & 7) as usize + 1;
        (self.0 & Child::LEAF != 0).then_some(first..first + count)
    }
}

/// Eight boxes and what is in them.
#[derive(Debug, Clone)]
#[repr(C, align(64))]
pub struct Node {
    /// `bounds[axis][0]` minimum, `bounds[axis][1]` maximum, per child. Empty children: min = +inf, max = -inf.
    pub bounds: [[[f32; WIDTH]; 2]; 3],
    pub children: [Child; WIDTH],
}

impl Node {
    pub const EMPTY: Node =
        Node { bounds: [[[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]]; 3], children: [Child(0); WIDTH] };
}

/// Nodes, the root first, and the blocks of their leaves. Without triangles there is no node.
#[derive(Debug, Default)]
pub struct Hierarchy {
    pub nodes: Vec<Node>,
    pub blocks: Vec<TriangleBlock>,
}
