//! What a stage is: parameters, guides, catalogue, validation, YAML.
