// The same as query.c, in C++: python examples/save_cell.py cell.lwn, then ./query cell.lwn

#include <loewner.hpp>

#include <algorithm>
#include <iostream>
#include <random>

int main(int count, char **arguments)
try {
    const loewner::Checker checker(count > 1 ? arguments[1] : "cell.lwn");
    loewner::Workspace workspace;
    const auto [lower, upper] = checker.limits();
    std::mt19937 random(1);
    const auto free_configuration = [&] {
        std::vector<double> q(checker.dof());
        do
            for (std::size_t k = 0; k < q.size(); k++)
                q[k] = std::uniform_real_distribution<>(std::max(lower[k], -3.14), std::min(upper[k], 3.14))(random);
        while (checker.collide(workspace, q) != loewner::Verdict::Free);
        return q;
    };
    const auto start = free_configuration(), goal = free_configuration();
    const auto path = checker.plan(workspace, start, goal);
    const auto nearest = checker.distance(workspace, goal);
    std::cout << "a proven path of " << path.size() / checker.dof() << " configurations; at its end "
              << checker.body_name(nearest.bodies[0]) << " is " << nearest.distance << " m from "
              << checker.body_name(nearest.bodies[1]) << '\n';
} catch (const loewner::Error &error) {
    std::cerr << error.what() << '\n';
    return 1;
}
