//! ROS domains of the tests in one file: each test has one of its own, which no other process uses.

use std::collections::BTreeMap;
use std::sync::Mutex;

use friction_stage::node::domain::OwnDomain;

/// The domain of a test, by its number in the file; it is kept until the process ends.
pub fn domain(test: u16) -> u16 {
    static TAKEN: Mutex<BTreeMap<u16, OwnDomain>> = Mutex::new(BTreeMap::new());
    let mut taken = TAKEN.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    taken.entry(test).or_insert_with(|| OwnDomain::take().expect("a free domain")).number()
}
