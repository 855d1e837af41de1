# Completion of whittle for fish: commands, the options that this whittle lists with what each takes, files.
# SPDX-License-Identifier: GPL-3.0-or-later
complete -c whittle -n __fish_use_subcommand -a tiles -d 'A cloud that does not fit into memory, step by step'
complete -c whittle -n __fish_use_subcommand -a convert -d 'All points, in another format'
complete -c whittle -n __fish_use_subcommand -a info -d 'What a cloud is'
complete -c whittle -n __fish_use_subcommand -a measure -d 'Distances between two clouds or meshes'
set -l plain 'not __fish_seen_subcommand_from info measure'
for line in (whittle --list-options 2>/dev/null)
    set -l part (string split \t -- $line)
    set -l name (string replace -r '^--' '' -- $part[1])
    switch $part[2]
        case ''
            complete -c whittle -n $plain -l $name -d $part[3]
        case FILE
            complete -c whittle -n $plain -l $name -r -F -d $part[3]
        case VALUE
            complete -c whittle -n $plain -l $name -x -d $part[3]
        case '*'
            complete -c whittle -n $plain -l $name -x -d $part[3] -a "(__fish_complete_list , 'string split , $part[2]')"
    end
end
for name in json quick help
    complete -c whittle -n '__fish_seen_subcommand_from info' -l $name
end
for name in columns threads
    complete -c whittle -n '__fish_seen_subcommand_from info' -l $name -x
end
for name in samples seed columns threads
    complete -c whittle -n '__fish_seen_subcommand_from measure' -l $name -x
end
complete -c whittle -n '__fish_seen_subcommand_from measure' -l method -x -a 'uniform metro'
complete -c whittle -n '__fish_seen_subcommand_from measure' -l json
complete -c whittle -n '__fish_seen_subcommand_from measure' -l help
