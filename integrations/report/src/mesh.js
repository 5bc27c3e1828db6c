// The level's triangles, divided so far that light between their corners is hardly wrong: shown while the camera moves. Where
// it rests every pixel is lit by itself.

const MOST_TRIANGLES = 150_000;

/** Arrays of corners, three for each triangle, from the level's blobs. */
export function meshOf( { positions, normals, triangles, albedo, emission }, edge ) {

	const area = ( a, b, c ) => {

		const [ u, v ] = [ b, c ].map( ( p ) => [ 0, 1, 2 ].map( ( k ) => positions[ 3 * p + k ] - positions[ 3 * a + k ] ) );
		return 0.5 * Math.hypot( u[ 1 ] * v[ 2 ] - u[ 2 ] * v[ 1 ], u[ 2 ] * v[ 0 ] - u[ 0 ] * v[ 2 ], u[ 0 ] * v[ 1 ] - u[ 1 ] * v[ 0 ] );

	};

	const count = triangles.length / 3;
	let total = 0;
	for ( let t = 0; t < count; t ++ ) total += area( ...triangles.subarray( 3 * t, 3 * t + 3 ) );
	while ( count + total / ( 0.2 * edge * edge ) > Math.max( MOST_TRIANGLES, 1.2 * count ) ) edge *= 1.3;

	const made = { positions: [], normals: [], sources: [] };
	const corner = ( vertex ) => [ ...positions.subarray( 3 * vertex, 3 * vertex + 3 ), ...normals.subarray( 3 * vertex, 3 * vertex + 3 ) ];
	for ( let t = 0; t < count; t ++ ) divide( [ 0, 1, 2 ].map( ( k ) => corner( triangles[ 3 * t + k ] ) ), t, edge, made, 0 );
	const of = ( values ) => Float32Array.from( { length: 9 * made.sources.length }, ( _, k ) => values[ 3 * made.sources[ Math.floor( k / 9 ) ] + k % 3 ] );
	return {
		positions: Float32Array.from( made.positions ),
		normals: Float32Array.from( made.normals ),
		albedo: of( albedo ),
		emission: emission ? of( emission ) : new Float32Array( 9 * made.sources.length ),
	};

}

// Through the middle of the longest side, until none is longer than `edge`.
function divide( corners, source, edge, made, depth ) {

	const lengths = corners.map( ( a, k ) => {

		const b = corners[ ( k + 1 ) % 3 ];
		return Math.hypot( a[ 0 ] - b[ 0 ], a[ 1 ] - b[ 1 ], a[ 2 ] - b[ 2 ] );

	} );
	const k = lengths.indexOf( Math.max( ...lengths ) );
	if ( lengths[ k ] <= edge || depth > 16 ) {

		for ( const corner of corners ) {

			made.positions.push( corner[ 0 ], corner[ 1 ], corner[ 2 ] );
			made.normals.push( corner[ 3 ], corner[ 4 ], corner[ 5 ] );

		}

		made.sources.push( source );
		return;

	}

	const [ a, b, c ] = [ 0, 1, 2 ].map( ( n ) => corners[ ( k + n ) % 3 ] );
	const middle = a.map( ( x, n ) => ( x + b[ n ] ) / 2 );
	divide( [ a, middle, c ], source, edge, made, depth + 1 );
	divide( [ middle, b, c ], source, edge, made, depth + 1 );

}
