//! The commit, by the script of the other programs.
//! A source distribution takes no build script from outside of the package.

#[path = "../files/commit.rs"]
mod commit;

fn main() {
    commit::main();
}
