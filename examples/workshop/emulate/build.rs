fn main() {
    cosmic_plan::compile("../cluster.toml");
}
