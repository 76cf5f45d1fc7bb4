//! Whether there is a GPU to test on. Where `NOCTULE_REQUIRE_GPU=1` a missing one fails the test, a software adapter being
//! enough; elsewhere the test says that it is skipped. `NOCTULE_REQUIRE_ADAPTER` names the one that the tests must run on.
//! From the first question on, an error of the validation layers ends the process.

use noctule::imaging::gpu::adapters;

/// Whether any adapter is there. Says so where none is.
pub fn gpu() -> bool {
    super::validation::watch();
    let adapters = adapters();
    if let Ok(wanted) = std::env::var("NOCTULE_REQUIRE_ADAPTER") {
        let first = adapters.first().map_or(String::new(), ToString::to_string);
        assert!(first.contains(&wanted), "NOCTULE_REQUIRE_ADAPTER={wanted}, but the tests would run on {first:?}");
    }
    let found = !adapters.is_empty();
    if !found {
        assert!(!required(), "NOCTULE_REQUIRE_GPU=1, but there is no adapter, not even a software one");
        println!("skipped: there is no GPU adapter, not even a software one");
    }
    found
}

/// Whether a missing GPU is a failure.
pub fn required() -> bool {
    std::env::var("NOCTULE_REQUIRE_GPU").is_ok_and(|value| value == "1")
}
