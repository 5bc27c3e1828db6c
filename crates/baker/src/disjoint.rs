//! Numbers that are joined to sets. Based on: Galler and Fischer, "An Improved Equivalence Algorithm", 1964.

/// Sets of the numbers 0 and up.
#[derive(Debug, Default)]
pub(crate) struct Disjoint {
    parents: Vec<u32>,
}

impl Disjoint {
    /// So many numbers at least, each new one in a set of its own.
    pub fn grow(&mut self, count: u32) {
        self.parents.extend(self.parents.len() as u32..count);
    }

    /// Joins the sets of two numbers.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.first(a), self.first(b));
        self.parents[a.max(b) as usize] = a.min(b);
    }

    /// The least number of the set that a number is in.
    pub fn first(&mut self, mut number: u32) -> u32 {
        while self.parents[number as usize] != number {
            let parent = self.parents[number as usize];
            self.parents[number as usize] = self.parents[parent as usize];
            number = parent;
        }
        number
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_in_one_set_if_a_chain_joins_them() {
        let mut sets = Disjoint::default();
        sets.grow(3);
        sets.grow(8);
        for (a, b) in [(7, 5), (2, 6), (5, 2), (1, 3)] {
            sets.join(a, b);
        }
        let firsts: Vec<u32> = (0..8).map(|number| sets.first(number)).collect();
        assert_eq!(firsts, [0, 1, 2, 1, 4, 2, 2, 2]);
    }
}
