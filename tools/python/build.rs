//! The commit, as the other programs have it; a source distribution takes no build script from outside of the package.

#[path = "../files/commit.rs"]
mod commit;

fn main() {
    commit::main();
}
